//! What an exchange between ranks makes of their numbers.

/// What is done with the numbers of all ranks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// Their sum, in whatever order MPI finds fastest.
    Sum,
    /// All of them, behind each other in the order of the ranks.
    Gather,
}
