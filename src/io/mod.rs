//! Files in and out: atomic writing, particle series for ParaView, states, tables, tensors.

pub mod atomic;
pub mod csv;
mod error;
pub mod hdf5_file;
pub mod state_file;
pub mod tensor_file;
pub mod tensorboard;
pub mod vtk;

pub use error::FileError;
