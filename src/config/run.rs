//! The sections `[run]` and `[output]`.

use crate::config::device::{Compute, DeviceName, Kernels};
use crate::config::range::Range::Within;
use crate::config::section::section;
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

section! {
    "run.": Run {
        precision: Precision = Precision::F64;
        threads: usize = 0, Within(0.0, 1024.0);
        seed: u64 = 0;
        kernels: Kernels = Kernels::Fused;
        device: DeviceName = DeviceName::Cpu;
    }
}

section! {
    "output.": Output {
        frames: usize = 40, Within(0.0, 1e5);
        /// Points of a grid along each axis.
        #[serde(skip_serializing_if = "Vec::is_empty")]
        grid: Vec<usize> = vec![];
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    F32,
    F64,
}

impl Precision {
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
