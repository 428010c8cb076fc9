//! Device of the operators: the CPU, or a GPU by candle's CUDA backend.

use crate::config::notation::{self, Written};
use crate::error::BadInput;
use candle_core::Device;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Mutex, PoisonError};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Kernels {
    /// One SIMD kernel and hand-written adjoint per operator.
    #[default]
    Fused,
    /// The same operators from ordinary candle ops: slow, the oracle.
    Composed,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeviceName {
    #[default]
    Cpu,
    /// The GPU with this number.
    Cuda(usize),
}

/// The accepted notation, for messages.
const FORM: &str = "cpu, cuda (the first GPU) or cuda:N (GPU number N, from 0)";

impl std::str::FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |digits: &str| match digits.bytes().all(|byte| byte.is_ascii_digit()) {
            true => digits.parse::<u16>().ok(),
            false => None,
        };
        let found = match text {
            "cpu" => Some(Self::Cpu),
            "cuda" => Some(Self::Cuda(0)),
            _ => text.strip_prefix("cuda:").and_then(number).map(|number| Self::Cuda(number.into())),
        };
        found.ok_or_else(|| format!("`{text}` is not a device; expected {FORM}"))
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => out.write_str("cpu"),
            Self::Cuda(number) => write!(out, "cuda:{number}"),
        }
    }
}

impl Serialize for DeviceName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for DeviceName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        notation::read(deserializer, FORM, |written| match written {
            Written::Text(text) => Some(text.parse()),
            _ => None,
        })
    }
}

/// The opened GPUs by number, because candle treats two openings of one GPU as two devices.
static OPENED: Mutex<BTreeMap<usize, Device>> = Mutex::new(BTreeMap::new());

impl DeviceName {
    /// Opens the device, or returns the one that is already open.
    ///
    /// # Errors
    /// [`BadInput`] (its key is `run.device`): a build without CUDA, a machine without such a GPU.
    pub fn open(self) -> Result<Device, BadInput> {
        let Self::Cuda(number) = self else { return Ok(Device::Cpu) };
        let bad = |why: &str| BadInput::at("run.device", format!("there is no device {self}: {why}"));
        if !cfg!(feature = "cuda") {
            return Err(bad("this hydrograd was built without CUDA")
                .allowed("cpu; GPUs in a program that was built with the feature `cuda`")
                .advice("run.device=cpu, or `scripts/cuda.sh cargo build -r -F cuda`, which gets the compiler"));
        }
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(device) = opened.get(&number) {
            return Ok(device.clone());
        }
        let device = Device::new_cuda(number).map_err(|error| {
            // The first line may be followed by a trace.
            let cause = error.to_string();
            bad(cause.lines().next().unwrap_or_default())
                .allowed("a GPU of this machine, as `nvidia-smi` numbers them from 0; cpu")
                .advice("run.device=cpu")
        })?;
        opened.insert(number, device.clone());
        Ok(device)
    }
}

/// Implementation of operators and networks, and their device.
#[derive(Debug, Clone)]
pub struct Compute {
    kernels: Kernels,
    device: Device,
}

impl Compute {
    /// Chooses composed operators on other devices than the CPU, because fused ones run only there.
    pub fn new(kernels: Kernels, device: Device) -> Self {
        let kernels = if device.is_cpu() { kernels } else { Kernels::Composed };
        Self { kernels, device }
    }

    pub fn kernels(&self) -> Kernels {
        self.kernels
    }

    pub fn device(&self) -> &Device {
        &self.device
    }
}

impl From<Kernels> for Compute {
    /// These kernels on the CPU.
    fn from(kernels: Kernels) -> Self {
        Self::new(kernels, Device::Cpu)
    }
}
