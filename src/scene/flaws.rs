//! What in the walls of a scene of one's own may make its flow diverge: walls that are too thin, passages that are too
//! narrow, walls at rest that move the fluid out of them, and formulas that do not go on behind a periodic side. The first
//! three are found at points of the surface, in any direction.

use super::custom;
use crate::config::scene::{Config, Method};
use crate::error::BadInput;
use crate::sph::divergence::Cause;

/// Smallest velocity out of a wall that counts, over the reference velocity.
const BLOWS: f64 = 0.05;

/// The flaw nearest to a place, as the cause of a divergence there; none if the walls have no flaw.
///
/// # Errors
/// As for building the scene.
pub(super) fn nearest(config: &Config, place: &[f64]) -> Result<Option<Cause>, BadInput> {
    let (dx, support) = (config.resolution.dx, config.support());
    let shapes = custom::shapes(config)?;
    let walls = custom::surroundings(config, &shapes);
    let lattice = custom::lattice(config);
    let mut found: Option<(f64, String)> = None;
    let mut note = |at: [f64; 3], problem: &str| {
        let apart = walls.apart(at, std::array::from_fn(|d| place.get(d).copied().unwrap_or(0.0)));
        if found.as_ref().is_none_or(|(nearest, _)| apart < *nearest) {
            let at: Vec<String> = at[..config.dimension()].iter().map(|x| format!("{x:.3}")).collect();
            found = Some((apart, format!("at ({}) {problem}", at.join(", "))));
        }
    };
    let places = || (0..lattice.particles()).map(|i| lattice.place(i));
    for foot in walls.points(places().filter(|p| walls.distance(*p).abs() <= dx)) {
        let (velocity, shape) = custom::wall_at(&walls, &foot)?;
        let out: f64 = velocity.iter().zip(foot.normal).map(|(u, n)| u * n).sum();
        let (thick, twice) = (walls.way(&foot, -1.0, support * dx), 2.0 * support);
        let wide = walls.way(&foot, 1.0, twice * dx).map(|wide| wide / dx);
        let problem = if let (Some(k), true) = (shape, out.abs() > BLOWS * config.fluid.reference_velocity) {
            format!(
                "shapes[{k}].velocity leads {} the wall with {:.3}, and walls stay where they are: it blows or sucks",
                if out > 0.0 { "out of" } else { "into" },
                out.abs()
            )
        } else if let Some(thick) = thick {
            format!(
                "the wall is {:.1} spacings thick, and the kernel reaches {support:.1}: fluid on one side sees the fluid on the other",
                thick / dx
            )
        } else if let Some(wide) = wide {
            format!("the passage is {wide:.1} spacings wide: below {twice:.1} a particle's sums reach both walls")
        } else {
            continue;
        };
        note(foot.place, &problem);
    }
    // Other shapes have periodic images, so that only formulas can end there.
    for d in (0..config.dimension()).filter(|&d| config.region.periodic[d]) {
        for p in places().filter(|p| p[d] < dx) {
            let beside = |x: f64| walls.distance(std::array::from_fn(|e| if e == d { x } else { p[e] }));
            let (first, last) = (beside(0.25 * dx), beside(config.region.size[d] - 0.25 * dx));
            if (first < 0.0) != (last < 0.0) && (first - last).abs() > dx {
                note(p, "the wall of a formula ends at the periodic side: its other side does not go on with it");
            }
        }
    }
    let advice = match config.method {
        Method::Consistent(_) => {
            "method.name=standard (it bears such walls as steps of the lattice and less exactly), or a smaller resolution.dx"
        }
        _ => "time.cfl=0.25, or a smaller resolution.dx",
    };
    Ok(found.map(|(_, why)| Cause { why, advice: advice.into(), is_open: false }))
}
