//! The cases of each group: their scenes, how they run, and how often.

use super::arguments::BenchArguments;
use super::case::{
    particles, Case, Group, Keeping, Kind, Lacking, Length, Network, Scene, Size, Source, COMPOSED, EVERYTHING_ON,
    FUSED, PLAN,
};
use crate::cli::prepare::require_design;
use crate::config::device::DeviceName;
use crate::config::scene::{Kernels, Precision};
use crate::error::Error;

/// Number of steps of a Taylor-Green run before the measurement, in which the particles leave their lattice.
fn warm_up(particles: usize, quick: bool) -> usize {
    match particles {
        _ if quick => 10,
        0..=20_000 => 200,
        20_001..=200_000 => 20,
        _ => 5,
    }
}

/// Cases that are compared with each other, with alternating repeats.
pub type Family = Vec<Case>;

/// Makes cases with the common settings of a run.
pub struct Cases<'a> {
    arguments: &'a BenchArguments,
    /// The scene of `step` and `gradient`, if the user named one.
    scene: Option<String>,
}

impl<'a> Cases<'a> {
    pub fn new(arguments: &'a BenchArguments, scene: Option<String>) -> Self {
        Self { arguments, scene }
    }

    /// The families of a group, without the rows that the filter excludes.
    pub fn of(&self, group: Group) -> Result<Vec<Family>, Error> {
        let mut families = match group {
            Group::Step => self.step()?,
            Group::Gradient => self.gradient()?,
            Group::Scaling => self.scaling(),
            Group::Plan => self.plan()?,
            Group::Kernels => self.kernels()?,
            Group::Surrogate => self.surrogate(),
            Group::Accuracy => vec![],
        };
        for family in &mut families {
            family.retain(|case| case.label().contains(&self.arguments.filter));
        }
        families.retain(|family| !family.is_empty());
        Ok(families)
    }

    /// The scenes to measure with their names: the user's, or the report's and the default one.
    fn scenes(&self) -> Vec<(String, Scene)> {
        let a = self.arguments;
        let given = Scene { scene: self.scene.clone(), preset: a.preset.clone(), sets: a.sets.clone() };
        if self.scene.is_some() || a.preset.is_some() {
            let name = self.scene.as_deref().unwrap_or("heated-channel");
            let stem = std::path::Path::new(name).file_stem().unwrap_or_default().to_string_lossy().to_string();
            return vec![(a.preset.as_ref().map_or(stem.clone(), |preset| format!("{stem}-{preset}")), given)];
        }
        vec![("heated-channel-report".into(), self.report()), ("heated-channel".into(), given)]
    }

    /// The report's channel.
    fn report(&self) -> Scene {
        Scene { preset: Some("report-jax-sph".into()), sets: self.arguments.sets.clone(), scene: None }
    }

    /// A case for each floating-point type and number of threads.
    fn variants(&self, base: &Case) -> Family {
        let threads = self.arguments.threads();
        let of = |precision| threads.iter().map(move |&threads| Case { precision, threads, ..base.clone() });
        self.arguments.precisions().into_iter().flat_map(of).collect()
    }

    fn case(&self, group: Group, scene: &str, particles: usize, source: Source) -> Case {
        Case {
            group,
            scene: scene.into(),
            particles,
            precision: Precision::F64,
            threads: 1,
            kind: Kind::Forward,
            mode: None,
            source,
            kernels: self.arguments.kernels,
            device: self.arguments.device,
            keeping: Keeping::EveryState,
            warm_up: 0,
            length: Length::Steps(1),
            blocks: 1,
            memory_limit: self.arguments.memory_limit.bytes(),
        }
    }

    fn step(&self) -> Result<Vec<Family>, Error> {
        let mut families = vec![];
        for (name, scene) in self.scenes() {
            let config = scene.load()?.config;
            let quick = self.arguments.quick;
            let n = particles(&config)?;
            let (warm_up, length) = match config.has_design() {
                // The whole run from its start.
                true => (0, Length::Steps(if quick { config.steps().min(1000) } else { config.steps() })),
                // Others may take hours.
                false => (warm_up(n, quick), Length::Seconds { seconds: if quick { 0.2 } else { 1.0 }, least: 16 }),
            };
            let base = Case {
                warm_up,
                length,
                blocks: if quick { 2 } else { 3 },
                ..self.case(Group::Step, &name, n, Source::Scene(scene))
            };
            families.push(self.variants(&base));
        }
        Ok(families)
    }

    fn gradient(&self) -> Result<Vec<Family>, Error> {
        let quick = self.arguments.quick;
        let mut families = vec![];
        // Only the report's channel, unless the user named a scene.
        for (name, mut scene) in self.scenes().into_iter().take(1) {
            if quick {
                scene = scene.with_defaults(&["time.steps=400", "objective.window=0"]);
            }
            let config = scene.load()?.config;
            require_design(&config)?;
            let (steps, n) = (config.steps(), particles(&config)?);
            let horizon = config.optimise.horizon.min(steps);
            let mut keepings = vec![
                Keeping::EveryState,
                Keeping::LeastMemory,
                Keeping::Share(0.1),
                Keeping::Truncated(horizon),
                Keeping::Taped,
            ];
            if !quick && steps > 200 {
                keepings.splice(3..3, [Keeping::Segments(200), Keeping::Binomial(20)]);
            }
            keepings.extend(self.arguments.memory.map(Keeping::Within));
            let base = Case {
                kind: Kind::Gradient,
                length: Length::Steps(steps),
                // The first gradient of a process also pays for new pages of memory (on a virtual machine up to a
                // quarter of its time), which an optimisation does only once.
                blocks: 2,
                ..self.case(Group::Gradient, &name, n, Source::Scene(scene))
            };
            let modes = |variant: Case| {
                // In f32 rounding a state does not change it.
                let rounded = (variant.precision == Precision::F64).then_some(Keeping::Rounded);
                let keepings = keepings.iter().copied().chain(rounded);
                keepings.map(move |k| Case { keeping: k, mode: Some(k.name()), ..variant.clone() })
            };
            families.push(self.variants(&base).into_iter().flat_map(modes).collect());
        }
        Ok(families)
    }

    /// The sizes of `scaling`: about 10^3 to 10^6 particles. 96^2 and 185^2 equal JAX-SPH's 9 200 and 34 400 within a
    /// per cent, 50^2 is LagrangeBench's.
    fn sizes(&self) -> Vec<Size> {
        let given = &self.arguments.sizes;
        if !given.is_empty() {
            return given.clone();
        }
        let (plane, space): (&[usize], &[usize]) = match self.arguments.quick {
            true => (&[31, 100, 316], &[20]),
            false => (&[31, 50, 96, 100, 185, 316, 1000], &[20, 40, 80]),
        };
        let all = plane.iter().map(|side| (side, 2)).chain(space.iter().map(|side| (side, 3)));
        all.map(|(&per_side, dimension)| Size { per_side, dimension }).collect()
    }

    fn scaling(&self) -> Vec<Family> {
        let quick = self.arguments.quick;
        let mut families = vec![];
        for size in self.sizes() {
            let n = size.particles();
            let seconds = if quick { 0.2 } else { 1.0 };
            let base = Case {
                warm_up: warm_up(n, quick),
                length: Length::Seconds { seconds, least: if quick { 4 } else { 16 } },
                ..self.case(Group::Scaling, size.scene(), n, Source::TaylorGreen(size))
            };
            families.push(self.variants(&base));
            let gradient = Case {
                kind: Kind::Gradient,
                mode: Some(Keeping::EveryState.name()),
                length: Length::Seconds { seconds, least: if quick { 2 } else { 4 } },
                ..base
            };
            families.push(self.variants(&gradient));
        }
        families
    }

    fn plan(&self) -> Result<Vec<Family>, Error> {
        let quick = self.arguments.quick;
        let mut families = vec![];
        for lacking in Lacking::ALL {
            // 3200 particles, so that the work is visible beside the threads' synchronisation.
            let dx = if quick { "resolution.dx=0.02" } else { "resolution.dx=0.01" };
            let scene = self.report().with_defaults(&[dx, "method.transport_velocity=1"]);
            let n = lacking.particles(&scene.load()?.config)?;
            for kind in [Kind::Forward, Kind::Gradient] {
                let seconds = if quick { 0.1 } else { 0.5 };
                let base = Case {
                    kind,
                    warm_up: if quick { 20 } else { 100 },
                    length: Length::Seconds { seconds, least: 10 },
                    blocks: 2,
                    ..self.case(Group::Plan, lacking.name(), n, Source::TaylorGreen(Size { per_side: 8, dimension: 2 }))
                };
                let with = |forced: bool| Case {
                    mode: Some(if forced { EVERYTHING_ON } else { PLAN }.into()),
                    source: Source::Plan { scene: scene.clone(), lacking, forced },
                    ..base.clone()
                };
                let both = [with(false), with(true)];
                let (precision, threads) = (self.arguments.precisions()[0], self.arguments.last_threads());
                families.push(both.map(|case| Case { precision, threads, ..case }).to_vec());
            }
        }
        Ok(families)
    }

    /// The report's channel, vortices in a box and a network, with alternating fused and composed operators.
    fn kernels(&self) -> Result<Vec<Family>, Error> {
        let quick = self.arguments.quick;
        let steps = format!("time.steps={}", if quick { 10 } else { 100 });
        let scene = self.report().with_defaults(&[&steps, "objective.window=0"]);
        let config = scene.load()?.config;
        let channel = Case {
            length: Length::Steps(config.steps()),
            ..self.case(Group::Kernels, "heated-channel", particles(&config)?, Source::Scene(scene))
        };
        let given = self.arguments.sizes.clone();
        let sizes = match given.is_empty() {
            false => given,
            true => vec![Size { per_side: if quick { 31 } else { 100 }, dimension: 2 }],
        };
        let vortices = sizes.into_iter().map(|size| Case {
            warm_up: warm_up(size.particles(), true),
            length: Length::Steps(if quick { 2 } else { 10 }),
            ..self.case(Group::Kernels, size.scene(), size.particles(), Source::TaylorGreen(size))
        });
        let network = Network::ALL[2];
        let network = Case {
            length: Length::Seconds { seconds: if quick { 0.1 } else { 1.0 }, least: 1 },
            ..self.case(Group::Kernels, &network.name(), Network::PARTICLES, Source::Network(network))
        };
        let flows = std::iter::once(channel).chain(vortices);
        let flows = flows.flat_map(|base| [Kind::Forward, Kind::Gradient].map(|kind| (base.clone(), kind)));
        let networks = [Kind::Forward, Kind::Training].map(|kind| (network.clone(), kind));
        let family = |(base, kind): (Case, Kind)| -> Family {
            // Networks are trained in f32.
            let precision = match base.source {
                Source::Network(_) => Precision::F32,
                _ => self.arguments.precisions()[0],
            };
            let with = |kernels: Kernels, mode: &str, blocks: usize| Case {
                kind,
                kernels,
                // Fused operators run only on the CPU.
                device: if kernels == Kernels::Fused { DeviceName::Cpu } else { base.device },
                mode: Some(mode.into()),
                blocks: if quick { 1 } else { blocks },
                precision,
                threads: self.arguments.last_threads(),
                ..base.clone()
            };
            // Fused runs are short, so their best needs more repeats.
            vec![with(Kernels::Fused, FUSED, 10), with(Kernels::Composed, COMPOSED, 2)]
        };
        Ok(flows.chain(networks).map(family).collect())
    }

    /// Networks on one graph, only in f32, in which they are trained.
    fn surrogate(&self) -> Vec<Family> {
        let quick = self.arguments.quick;
        let family = |network: Network| {
            let (name, n) = (network.name(), Network::PARTICLES);
            let base = Case {
                precision: Precision::F32,
                length: Length::Seconds { seconds: if quick { 0.2 } else { 2.0 }, least: 1 },
                blocks: if quick { 2 } else { 4 },
                ..self.case(Group::Surrogate, &name, n, Source::Network(network))
            };
            let (threads, base) = (self.arguments.threads(), &base);
            let of = |kind| threads.iter().map(move |&threads| Case { kind, threads, ..base.clone() });
            [Kind::Forward, Kind::Training].into_iter().flat_map(of).collect()
        };
        Network::ALL.map(family).to_vec()
    }
}
