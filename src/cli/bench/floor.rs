//! The plain-C yardstick: compiled with gcc, run in turns with the cases that it has too.

use std::path::Path;
use std::process::{Command, Stdio};

use tempfile::TempDir;

use super::cases::{precision_name, Case, Keeping, Kind, Source};
use crate::config::scene::Precision;
use crate::error::{BadInput, Error};

/// The compiled yardstick, one program per floating-point type.
pub struct Floor {
    folder: TempDir,
    /// Timed seconds of each run.
    seconds: f64,
}

/// A case as the yardstick knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct FloorRun {
    /// `channel H dx` or `tgv n`.
    arguments: Vec<String>,
    particles: usize,
    precision: Precision,
    threads: usize,
    kind: Kind,
}

impl FloorRun {
    /// `None` if the yardstick does not have the case.
    pub fn of(case: &Case) -> Result<Option<Self>, Error> {
        let arguments = match &case.source {
            Source::Channel(scene) => {
                let config = scene.load()?.config;
                // Its time step is that of CFL 0.25, its channel has length 1.
                if config.time.cfl != 0.25 || config.channel.length != 1.0 {
                    return Ok(None);
                }
                let text = |value: f64| value.to_string();
                vec!["channel".into(), text(config.channel.height), text(config.resolution.dx)]
            }
            Source::TaylorGreen(size) if size.dimension == 2 => vec!["tgv".into(), size.per_side.to_string()],
            _ => return Ok(None),
        };
        if case.kind == Kind::Gradient && matches!(case.keeping, Keeping::Truncated(_)) {
            return Ok(None);
        }
        let Case { particles, precision, threads, kind, .. } = *case;
        Ok(Some(Self { arguments, particles, precision, threads, kind }))
    }
}

impl Floor {
    /// Compiles `floor.c` of this folder.
    pub fn compile(source: &Path, quick: bool) -> anyhow::Result<Self> {
        let place = format!("--floor {}", source.display());
        let file = source.join("floor.c");
        if !file.is_file() {
            return Err(BadInput::new(format!("there is no file {}", file.display()))
                .place(place)
                .allowed("the folder of the plain-C yardstick, with floor.c, adjoint.h and simd.h")
                .into());
        }
        let folder = tempfile::tempdir()?;
        for precision in [Precision::F64, Precision::F32] {
            let mut gcc = Command::new("gcc");
            gcc.args(["-O3", "-march=native", "-fopenmp"]);
            if precision == Precision::F32 {
                gcc.arg("-DF32");
            }
            let program = folder.path().join(precision_name(precision));
            let output = gcc.arg(&file).arg("-o").arg(program).arg("-lm").stdin(Stdio::null()).output();
            let output = output.map_err(|error| {
                Error::run(format!("{place}: can not run gcc: {error}"), "apt-get install gcc, or no --floor")
            })?;
            if !output.status.success() {
                let message = String::from_utf8_lossy(&output.stderr);
                let problem = format!("{place}: gcc can not compile it: {}", message.trim());
                return Err(Error::run(problem, "another gcc, or no --floor").into());
            }
        }
        Ok(Self { folder, seconds: if quick { 0.2 } else { 1.0 } })
    }

    /// Best and median milliseconds per step: for a gradient, of a forward and an adjoint step.
    pub fn measure(&self, run: &FloorRun) -> Result<[f64; 2], Error> {
        let forward = self.once(run, "")?;
        Ok(match run.kind {
            Kind::Forward => forward,
            Kind::Gradient | Kind::Training => {
                let adjoint = self.once(run, "adjoint-")?;
                [forward[0] + adjoint[0], forward[1] + adjoint[1]]
            }
        })
    }

    fn once(&self, run: &FloorRun, prefix: &str) -> Result<[f64; 2], Error> {
        let first = format!("{prefix}{}", run.arguments[0]);
        let name = format!("floor {first} {}", run.arguments[1..].join(" "));
        let failed = |problem: String| Error::run(format!("{name}: {problem}"), "run it without --floor");
        let output = Command::new(self.folder.path().join(precision_name(run.precision)))
            .arg(first)
            .args(&run.arguments[1..])
            .env("THREADS", run.threads.to_string())
            .env("SECONDS_PER_CASE", self.seconds.to_string())
            .stdin(Stdio::null())
            .output()
            .map_err(|error| failed(error.to_string()))?;
        if !output.status.success() {
            let message = String::from_utf8_lossy(&output.stderr);
            return Err(failed(format!("it failed ({}): {}", output.status, message.trim())));
        }
        let text = String::from_utf8_lossy(&output.stdout);
        let value: serde_json::Value =
            serde_json::from_str(text.trim()).map_err(|error| failed(format!("not JSON: {error}: {text}")))?;
        if value["N"].as_u64() != Some(run.particles as u64) {
            return Err(failed(format!("it has {} particles instead of {}", value["N"], run.particles)));
        }
        match (value["ms_per_step"].as_f64(), value["ms_median"].as_f64()) {
            (Some(best), Some(median)) if best > 0.0 => Ok([best, median]),
            _ => Err(failed(format!("no ms_per_step and ms_median in {text}"))),
        }
    }
}
