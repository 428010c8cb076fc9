//! The ranks that share the flow of a design problem: the first one searches, and tells the others what it needs.

use crate::adjoint::schedule::{Kind, Schedule};
use crate::config::scene::Kernels;
use crate::error::BadInput;
use crate::numerics::ranks::Ranks;
use crate::sph::dynamics::Sph;
use crate::sph::method::{Model, Sharing};
use crate::sph::spread::sharing;
use crate::sph::spread_gradient::Spread;
use crate::sph::Sweeps;

/// The ranks that share a problem's flow, and how.
#[derive(Debug, Clone)]
pub struct Team {
    ranks: Ranks,
    sharing: Sharing,
}

/// What the first rank tells the others to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Nothing more.
    End,
    /// The objective of a design.
    Value,
    /// Its gradient.
    Gradient(Schedule),
}

impl Order {
    /// Numbers of an order.
    const WIDTH: usize = 6;

    fn numbers(self) -> [f64; Self::WIDTH] {
        let schedule = match self {
            Self::End => return [0.0; Self::WIDTH],
            Self::Value => return [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            Self::Gradient(schedule) => schedule,
        };
        let (kind, of) = match schedule.kind {
            Kind::EveryState { rounded } => (2, usize::from(rounded)),
            Kind::Segments { length } => (3, length),
            Kind::TwoLevel { interval } => (4, interval),
            Kind::Binomial { states } => (5, states),
        };
        [f64::from(kind), of as f64, schedule.steps as f64, schedule.first as f64, schedule.clip, 0.0]
    }

    fn of(numbers: &[f64]) -> Self {
        let of = numbers[1] as usize;
        let kind = match numbers[0] as u8 {
            0 => return Self::End,
            1 => return Self::Value,
            2 => Kind::EveryState { rounded: of == 1 },
            3 => Kind::Segments { length: of },
            4 => Kind::TwoLevel { interval: of },
            _ => Kind::Binomial { states: of },
        };
        Self::Gradient(Schedule { steps: numbers[2] as usize, first: numbers[3] as usize, kind, clip: numbers[4] })
    }
}

impl Team {
    /// # Errors
    /// [`BadInput`]: a flow that these ranks cannot share, or whose gradient they cannot.
    pub fn new<R: Sweeps>(model: &Model<R>, ranks: &Ranks) -> Result<Self, BadInput> {
        if model.division.is_some() {
            return Err(BadInput::new("gradients over several ranks of steps that the flow divides")
                .key("time.adaptive")
                .allowed("false")
                .advice("time.adaptive=false"));
        }
        Ok(Self { ranks: ranks.clone(), sharing: sharing(model, ranks)? })
    }

    /// Tells the other ranks what to do with variables. Only the first one does.
    pub fn tell(&self, order: Order, variables: &[f64]) {
        if self.ranks.rank() == 0 {
            self.ranks.all(&[&order.numbers()[..], variables].concat());
        }
    }

    /// What the first rank tells this one, about so many variables.
    pub fn told(&self, variables: usize) -> (Order, Vec<f64>) {
        let width = Order::WIDTH + variables;
        let told = self.ranks.all(&vec![0.0; width]);
        (Order::of(&told), told[Order::WIDTH..width].to_vec())
    }

    /// The flow over these ranks.
    pub fn spread<R: Sweeps>(&self, model: &Model<R>) -> Spread<R> {
        Spread::new(Sph::new(model.clone(), Kernels::Fused), self.sharing, &self.ranks)
    }
}
