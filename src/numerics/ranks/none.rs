//! No MPI: there are no other ranks, and nothing here can be made.

use super::How;
use crate::error::BadInput;

pub enum World {}

pub enum Exchange {}

impl World {
    pub fn begin(several: usize) -> Result<Self, BadInput> {
        Err(BadInput::new(format!(
            "{several} processes were started together, and this hydrograd cannot talk to the others"
        ))
        .allowed("one process, or a program built with MPI")
        .advice("build it with the feature mpi, or start it without mpirun"))
    }

    pub fn rank(&self) -> usize {
        match *self {}
    }

    pub fn size(&self) -> usize {
        match *self {}
    }

    pub fn on_this_machine(&self) -> usize {
        match *self {}
    }

    pub fn all(&self, _: &[f64]) -> Vec<f64> {
        match *self {}
    }

    pub fn counts(&self, _: &[f64]) -> Vec<f64> {
        match *self {}
    }

    pub fn begin_swap(&self, _: Vec<(usize, Vec<f64>)>, _: &[(usize, usize)]) -> Swap {
        match *self {}
    }

    pub fn begin_exchange(&self, _: Vec<f64>, _: How) -> Exchange {
        match *self {}
    }

    pub fn abort(&self, _: u8) {
        match *self {}
    }
}

pub enum Swap {}

impl Swap {
    pub fn go_on(&mut self) {
        match *self {}
    }

    pub fn wait(self) -> Vec<Vec<f64>> {
        match self {}
    }
}

impl Exchange {
    pub fn go_on(&mut self) {
        match *self {}
    }

    pub fn wait(self) -> Vec<f64> {
        match self {}
    }
}
