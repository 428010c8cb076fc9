//! Reads JAX-SPH's reference files and sets up our solver from a group's configuration.

use hdf5::{Group, Location};
use hydrograd::particles::{tag, Domain};
use hydrograd::sph::flow::{Flow, Heat};
use hydrograd::sph::kernels::{Kernel, KernelName};
use hydrograd::sph::laws::body_force::BodyForce;
use hydrograd::sph::laws::equation_of_state::EquationOfState;
use hydrograd::sph::laws::{
    ArtificialViscosity, DensityDiffusion, DensityGradient, Flux, Riemann, Slip, VelocityDiffusion,
};
use hydrograd::sph::standard::{Laws, Layout, Standard};
use serde_json::Value;
use std::path::PathBuf;

/// The file named by the environment variable, or the committed copy.
pub fn reference_file(variable: &str, committed: &str) -> PathBuf {
    match std::env::var_os(variable) {
        Some(path) => PathBuf::from(path),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/reference").join(committed),
    }
}

pub fn number(location: &Location, name: &str) -> f64 {
    let attribute = location.attr(name).unwrap_or_else(|e| panic!("attribute {name}: {e}"));
    if let Ok(x) = attribute.read_scalar::<f64>() {
        return x;
    }
    attribute.read_scalar::<i64>().unwrap_or_else(|e| panic!("attribute {name}: {e}")) as f64
}

pub fn text(location: &Location, name: &str) -> String {
    let attribute = location.attr(name).unwrap_or_else(|e| panic!("attribute {name}: {e}"));
    attribute
        .read_scalar::<hdf5::types::VarLenUnicode>()
        .unwrap_or_else(|e| panic!("attribute {name}: {e}"))
        .to_string()
}

/// A field as rows `[columns][n]`; constants are stored as attributes.
pub fn field(group: &Group, name: &str, n: usize, columns: usize) -> Option<Vec<Vec<f64>>> {
    if let Ok(dataset) = group.dataset(name) {
        let raw = dataset.read_raw::<f64>().unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(raw.len(), n * columns, "{}: {name} has the wrong size", group.name());
        return Some((0..columns).map(|c| (0..n).map(|i| raw[i * columns + c]).collect()).collect());
    }
    let attribute = group.attr(name).ok()?;
    let value = attribute.read_scalar::<f64>().ok()?;
    Some(vec![vec![value; n]; columns])
}

/// A group's configuration, or why we cannot run it.
pub struct Case {
    pub dimension: usize,
    pub n: usize,
    pub tags: Vec<u8>,
    pub transport: f64,
    pub heat: bool,
    pub reference_temperature: f64,
    pub size: Vec<f64>,
    /// Of the walls in the first state, `[D, N]`, where the case has them.
    pub normals: Option<Vec<f64>>,
    pub dx: f64,
    config: Value,
    dt: f64,
    mass: f64,
    eta: f64,
    kappa: f64,
    capacity: f64,
}

impl Case {
    pub fn read(group: &Group) -> Result<Self, String> {
        let config: Value = serde_json::from_str(&text(group, "cfg")).expect("cfg is JSON");
        let (solver, case) = (&config["solver"], &config["case"]);
        let refuse = |wrong: bool, why: &str| if wrong { Err(why.to_string()) } else { Ok(()) };
        let name = solver["name"].as_str().unwrap_or("");
        refuse(!["SPH", "DELTA", "RIE"].contains(&name), &format!("solver {name}"))?;
        let kernel = config["kernel"]["name"].as_str().unwrap_or("");
        refuse(!["QSK", "WC2K"].contains(&kernel), &format!("kernel {kernel}"))?;
        let gamma = config["eos"]["gamma"].as_f64().unwrap_or(0.0);
        refuse(config["eos"]["name"] != "Tait", "equation of state")?;
        refuse(gamma < 1.0 || gamma.fract() != 0.0, "gamma")?;
        for constant in ["mass", "eta", "kappa", "Cp"] {
            refuse(group.attr(constant).is_err(), &format!("{constant} varies"))?;
        }
        let tags: Vec<u8> =
            group.dataset("tag").unwrap().read_raw::<i8>().unwrap().into_iter().map(|t| t as u8).collect();
        let walls = tags.iter().any(|&t| t != tag::FLUID);
        refuse(walls && solver["is_bc_trick"].as_bool() != Some(true), "walls without extrapolation")?;
        let family = case["name"].as_str().unwrap_or("");
        let known = ["ht", "pf", "cf", "tgv", "rpf", "ldc", "cw", "db"].contains(&family);
        refuse(!known && case["g_ext_magnitude"].as_f64() != Some(0.0), &format!("body force of case {family}"))?;
        // With the Riemann solver JAX-SPH's pressure is 100 u_ref^2 (rho - rho_ref): Tait's with gamma = 1, if the rest is 1.
        let linear =
            [("rho_ref", 1.0), ("c_ref_factor", 10.0)].iter().all(|&(key, one)| case[key].as_f64() == Some(one));
        refuse(name == "RIE" && !(linear && gamma == 1.0), "equation of state of the Riemann solver")?;
        let normals = field(group, "nw", tags.len(), case["dim"].as_u64().unwrap() as usize).map(|rows| rows.concat());
        let turns = normals.is_some() && tags.contains(&tag::MOVING_WALL);
        let is_cavity = family == "ldc" && case["dim"].as_u64() == Some(2);
        refuse(turns && !is_cavity, &format!("normals of the moving wall of case {family}"))?;
        let size = group.attr("box_size").unwrap().read_raw::<f64>().unwrap();
        Ok(Self {
            dimension: case["dim"].as_u64().unwrap() as usize,
            n: tags.len(),
            tags,
            normals,
            transport: solver["tvf"].as_f64().unwrap(),
            heat: solver["heat_conduction"].as_bool().unwrap(),
            reference_temperature: case["T_ref"].as_f64().unwrap(),
            size,
            dx: number(group, "dx"),
            dt: number(group, "dt"),
            mass: number(group, "mass"),
            eta: number(group, "eta"),
            kappa: number(group, "kappa"),
            capacity: number(group, "Cp"),
            config,
        })
    }

    fn body_force(&self) -> BodyForce {
        let case = &self.config["case"];
        let strength = case["g_ext_magnitude"].as_f64().unwrap();
        let rows = self.wall_rows() * self.dx;
        match case["name"].as_str().unwrap() {
            _ if strength == 0.0 => BodyForce::None,
            "ht" => BodyForce::Band { strength, from: rows, to: self.size[1] - rows },
            "pf" => {
                let height = case["special"]["H"].as_f64().unwrap_or(1.0);
                BodyForce::Band { strength, from: rows, to: height + rows }
            }
            "cw" | "db" => BodyForce::Gravity([0.0, -strength, 0.0]),
            "rpf" => BodyForce::Reversing { strength, turn: 1.0 },
            _ => BodyForce::None,
        }
    }

    fn kernel(&self) -> KernelName {
        match self.config["kernel"]["name"].as_str().unwrap() {
            "WC2K" => KernelName::WendlandC2,
            _ => KernelName::QuinticSpline,
        }
    }

    fn flux(&self, smoothing_length: f64) -> Flux {
        let (solver, case) = (&self.config["solver"], &self.config["case"]);
        let (of, sound_speed) = (|key: &str| solver[key].as_f64().unwrap(), case["c_ref"].as_f64().unwrap());
        match solver["name"].as_str().unwrap() {
            "DELTA" => Flux::Delta(DensityDiffusion {
                strength: of("diff_delta"),
                sound_speed,
                smoothing_length,
                gradient: DensityGradient::JaxSph,
            }),
            "RIE" => Flux::Riemann(Riemann { sound_speed, limiter: of("eta_limiter") }),
            _ => Flux::Pair,
        }
    }

    /// Rows of dummy particles of each wall.
    pub fn wall_rows(&self) -> f64 {
        self.config["solver"]["n_walls"].as_f64().unwrap()
    }

    /// Whether JAX-SPH computes the walls' normals anew in each step: where something reads them and a wall moves.
    pub fn turns_normals(&self) -> bool {
        self.normals.is_some() && self.tags.contains(&tag::MOVING_WALL)
    }

    /// Whether the case sets the walls' pressure to 0 at the end of a step, when it has been used.
    pub fn forgets_wall_pressure(&self) -> bool {
        matches!(self.config["case"]["name"].as_str(), Some("cw" | "db"))
    }

    /// `everything`: compute the transport acceleration even where the scene does not use it, and carry the masses.
    pub fn model(&self, everything: bool) -> Standard<f64> {
        let (case, eos) = (&self.config["case"], &self.config["eos"]);
        let d = self.dimension;
        let mut domain = Domain { dimension: d, size: [1.0; 3], periodic: [false; 3] };
        for k in 0..d {
            domain.size[k] = self.size[k];
            domain.periodic[k] = true;
        }
        let alpha = self.config["solver"]["artificial_alpha"].as_f64().unwrap();
        let h = self.dx * self.config["kernel"]["h_factor"].as_f64().unwrap();
        let heat = self.heat.then(|| {
            let strip = self.wall_rows() * self.dx;
            let hot = case["special"]["hot_wall_temperature"].as_f64().unwrap_or(self.reference_temperature);
            Heat {
                conductivity: self.kappa,
                capacity: self.capacity,
                reference: self.reference_temperature,
                inlet_below: strip,
                outlet_above: self.size[0] - strip,
                wall_constant: self
                    .tags
                    .iter()
                    .map(|&t| if t == tag::HOT_WALL { hot - self.reference_temperature } else { 0.0 })
                    .collect(),
                wall_factor: self.tags.iter().map(|&t| if t == tag::HOT_WALL { 0.0 } else { 1.0 }).collect(),
                materials: None,
            }
        });
        let layout = Layout {
            dimension: d,
            transport: everything || self.transport != 0.0,
            heat: self.heat,
            mass: everything,
            density: self.config["solver"]["density_evolution"].as_bool().unwrap(),
        };
        let equation_of_state = EquationOfState {
            reference_density: case["rho_ref"].as_f64().unwrap(),
            reference_pressure: case["p_ref"].as_f64().unwrap(),
            background_pressure: case["p_bg"].as_f64().unwrap(),
            gamma: eos["gamma"].as_f64().unwrap() as i32,
        };
        let flow = Flow {
            kernel: Kernel::new(self.kernel(), d, h),
            mass: self.mass,
            viscosity: self.eta,
            body_force: self.body_force(),
            heat,
            ..Flow::new(domain, self.tags.clone(), self.dx, equation_of_state, self.dt)
        };
        let artificial_viscosity = (alpha > 0.0).then_some(ArtificialViscosity {
            alpha,
            beta: 0.0,
            // 10 u_ref with a u_ref of 1 whatever the case's is, and the spacing for h: theirs.
            sound_speed: 10.0,
            smoothing_length: self.dx,
            every_pair: true,
        });
        let velocity_diffusion = (self.config["solver"]["name"] == "DELTA").then(|| VelocityDiffusion {
            strength: self.config["solver"]["diff_alpha"].as_f64().unwrap(),
            sound_speed: case["c_ref"].as_f64().unwrap(),
            smoothing_length: h,
            reference_density: case["rho_ref"].as_f64().unwrap(),
        });
        let laws = Laws {
            transport: self.transport,
            further: (artificial_viscosity, velocity_diffusion),
            renormalises: self.config["solver"]["density_renormalize"].as_bool().unwrap(),
            flux: self.flux(h),
            slip: if self.config["solver"]["free_slip"].as_bool().unwrap() { Slip::Free } else { Slip::None },
            normals: self.normals.clone(),
        };
        Standard::new(flow, layout, laws)
    }

    /// Our packed state from a group of fields.
    pub fn state(&self, layout: &Layout, group: &Group) -> Vec<f64> {
        let (n, d) = (self.n, self.dimension);
        let mut state = vec![0.0; layout.state_rows() * n];
        let mut put = |row: usize, values: Vec<Vec<f64>>| {
            for (k, column) in values.into_iter().enumerate() {
                state[(row + k) * n..(row + k + 1) * n].copy_from_slice(&column);
            }
        };
        put(0, field(group, "r", n, d).expect("r"));
        put(layout.velocity(), field(group, "u", n, d).expect("u"));
        put(layout.acceleration(), field(group, "dudt", n, d).unwrap_or_else(|| vec![vec![0.0; n]; d]));
        if layout.transport {
            put(layout.transport_acceleration(), field(group, "dvdt", n, d).unwrap_or_else(|| vec![vec![0.0; n]; d]));
        }
        if layout.heat {
            let t = field(group, "T", n, 1).expect("T");
            put(layout.temperature(), vec![t[0].iter().map(|t| t - self.reference_temperature).collect()]);
            put(layout.temperature_rate(), field(group, "dTdt", n, 1).unwrap_or_else(|| vec![vec![0.0; n]]));
        }
        if layout.mass {
            put(layout.state_mass(), vec![vec![self.mass; n]]);
        }
        if layout.density {
            put(layout.state_density(), field(group, "rho", n, 1).expect("rho"));
        }
        state
    }
}
