//! The sections `[run]` and `[output]`.

use crate::config::device::{Compute, DeviceName, Kernels};
use crate::config::range::Range::Within;
use crate::config::section::section;
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

section! {
    "run.": Run {
        precision: Precision = Precision::F64;
        /// Worker threads; 0 takes every core.
        threads: usize = 0, Within(0.0, 1024.0);
        seed: u64 = 0;
        kernels: Kernels = Kernels::Fused;
        /// Device of the operators.
        device: DeviceName = DeviceName::Cpu;
    }
}

section! {
    "output.": Output {
        /// ParaView frames of a `simulate` run (and of the best design of `optimize`); 0 writes none.
        frames: usize = 40, Within(0.0, 1e5);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    F32,
    F64,
}

impl Precision {
    /// The name in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

impl Run {
    /// The implementation and the device of the operators.
    pub fn compute(&self) -> Result<Compute, BadInput> {
        Ok(Compute::new(self.kernels, self.device.open()?))
    }
}
