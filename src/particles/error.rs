//! What can go wrong when neighbours are looked for.

/// More neighbours than this means that particles have clumped: no flow of this kind has them.
pub(super) const MOST_NEIGHBOURS: usize = 1024;

/// The list could not be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NeighbourError {
    #[error("particle {particle} is at a position that is not a number or far outside the box (component {component}: {value}): the run has diverged")]
    LostParticle { particle: usize, component: usize, value: f64 },
    #[error("particle {particle} has {count} neighbours, more than {MOST_NEIGHBOURS}: particles have clumped, the run has diverged")]
    Clumped { particle: usize, count: usize },
    #[error(
        "particle {particle} moved {distance:.3e} in one step, more than half of the cut-off {cutoff:.3e}: the run has diverged"
    )]
    TooFast { particle: usize, distance: f64, cutoff: f64 },
    /// Particles must be handed over first.
    #[error("particles have moved too far for the copies that ranks have of them")]
    UsedUp,
    #[error("the box is {size} long in direction {direction}, shorter than twice the reach {reach} of a particle: use a longer periodic box or a smaller spacing")]
    BoxTooSmall { direction: usize, size: f64, reach: f64 },
}
