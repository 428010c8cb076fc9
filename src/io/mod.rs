//! Files in and out: atomic writing, particle series for ParaView, states, tables, tensors.

pub mod atomic;
pub mod csv;
mod error;
pub mod grid_file;
pub mod hdf5_file;
pub mod npy;
pub mod state_file;
pub mod stl;
pub mod tensor_file;
pub mod tensorboard;
pub mod vtk;

pub use error::FileError;
