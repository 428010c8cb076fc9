//! Data sets of trajectories in LagrangeBench's layout, with temperature beside the positions.
//!
//! A data set is a folder with `train.h5`, `valid.h5`, `test.h5` and `metadata.json`. Each file has one group per
//! trajectory ("00000", "00001", ...), see [`trajectory`]. `hydrograd generate` makes data sets: [`recipe`] describes
//! them, [`record`] runs their trajectories, [`store`] writes them.

pub mod extent;
pub mod metadata;
pub mod objective;
pub mod recipe;
pub mod record;
pub mod statistics;
pub mod store;
pub mod trajectory;
pub mod walls;

pub use metadata::{Heat, Metadata};
pub use trajectory::{kind, read_split, Split, Trajectory};
