//! The factors of the matrix of a step, see [`super::newton`].

use crate::numerics::sparse_lu::SparseLu;

/// L and U of K.
#[derive(Debug)]
pub struct Factors {
    pub flow: SparseLu,
    pub heat: SparseLu,
    /// K^-1 of the pinned pressure.
    pub idle: Vec<f64>,
    pub drive: Option<Kicked>,
}

/// What a drive adds to a step.
#[derive(Debug)]
pub struct Kicked {
    /// a, of flow and temperature, and K^-1 a.
    pub by_kick: [(Vec<f64>, Vec<f64>); 2],
    /// d, of the flow, and K^-T d.
    pub of_kick: [Vec<f64>; 2],
}
