//! Figures, each as `<stem>.png` (twice the nominal size, smoothed) and `<stem>.svg`.
//!
//! A figure is first a list of shapes (`drawing::Drawing`), laid out once; both formats show the same picture.

pub mod axis;
pub mod colors;
mod compare;
pub mod drawing;
mod field;
mod history;
pub mod lines;
mod relief;
mod side_by_side;
mod stability;
mod temperature;
mod training;
mod wall_shapes;

pub use compare::compare;
pub use field::{fields, Field, FieldPanel};
pub use history::{history, HistoryPoint};
pub use relief::{relief, ReliefPanel};
pub use side_by_side::{side_by_side, SideBySide};
pub use stability::{stability, StabilityAxes, StabilityPanel};
pub use temperature::{colored_particles, TemperaturePanel};
pub use training::{training_curves, ErrorCurve};
pub use wall_shapes::wall_shapes;
