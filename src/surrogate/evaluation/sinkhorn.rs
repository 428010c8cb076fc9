//! Sinkhorn divergence of two clouds of particles: the distance of their distributions, whatever the particles' order.
//!
//! With costs C_ij = |x_i - y_j|^2 (minimum image), weights 1/N and eps = 0.05 mean(C(x, y)), the regularised cost of
//! transport is OT(x, y) = max over f, g of mean(f) + mean(g) - eps mean_ij exp((f_i + g_j - C_ij)/eps) + eps, and
//! S(x, y) = OT(x, y) - (OT(x, x) + OT(y, y))/2, all with the eps of (x, y). Units: length^2.
//!
//! Source: Feydy et al. 2019 (arXiv:1810.08278), eq. 3. eps and the stopping rule are those of OTT
//! (`ott.tools.sinkhorn_divergence`) as called by LagrangeBench, for comparable values: a check every ten iterations,
//! until the sum of the marginals' errors is at most 1e-4. Further iterations change values by about 1e-10 of the box's
//! squared length, which is 1e-4 of a divergence of 1e-6.

use crate::dataset::extent::Extent;

/// eps as a fraction of the mean cost.
const REGULARISATION: f64 = 0.05;
/// Number of iterations between two checks, and between two absorptions of the scalings into the potentials.
const BLOCK: usize = 10;
const MOST_BLOCKS: usize = 200;

/// LagrangeBench's threshold of the marginals' error, the sum of |sum_j P_ij - 1/N|.
pub const THRESHOLD: f64 = 1e-4;

/// The error of iterations that do not converge.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the Sinkhorn divergence of {particles} particles does not converge (marginals still off by {error:.1e})")]
pub struct NotConverged {
    pub particles: usize,
    pub error: f64,
}

/// S(x, y) of two clouds `[N, D]`, iterated until the marginals' error is at most `threshold`; 0 without particles.
///
/// # Errors
/// No convergence: a particle far away from all others, or coordinates that are not finite.
pub fn divergence(extent: &Extent, x: &[f64], y: &[f64], threshold: f64) -> Result<f64, NotConverged> {
    let particles = x.len() / extent.dimension();
    if particles == 0 {
        return Ok(0.0);
    }
    let between = costs(extent, x, y);
    let epsilon = REGULARISATION * between.iter().sum::<f64>() / between.len() as f64;
    // If all particles are at one point, there is nothing to transport.
    if epsilon == 0.0 {
        return Ok(0.0);
    }
    let of = |costs: &[f64], symmetric| transport(costs, particles, epsilon, threshold, symmetric);
    let own = of(&costs(extent, x, x), true)? + of(&costs(extent, y, y), true)?;
    Ok(of(&between, false)? - 0.5 * own)
}

/// The costs C `[N, N]`.
fn costs(extent: &Extent, x: &[f64], y: &[f64]) -> Vec<f64> {
    let d = extent.dimension();
    let mut costs = Vec::with_capacity(x.len() / d * (y.len() / d));
    for a in x.chunks_exact(d) {
        for b in y.chunks_exact(d) {
            costs.push((0..d).map(|k| extent.shortest(k, a[k] - b[k]).powi(2)).sum());
        }
    }
    costs
}

/// OT of a cost matrix. The potentials change by eps log of the scalings u, v, which stay near 1, because every block
/// restarts from exp((f_i + g_j - C_ij)/eps)/N^2 (Schmitzer 2019, "absorption"). So a block costs one exponential per
/// pair, and nothing over- or underflows.
fn transport(costs: &[f64], n: usize, epsilon: f64, threshold: f64, symmetric: bool) -> Result<f64, NotConverged> {
    let (mut f, mut g) = (vec![0.0; n], vec![0.0; n]);
    let weight = 1.0 / n as f64;
    let mut plan = vec![0.0; n * n];
    let mut sums = vec![0.0; n];
    let mut error = f64::INFINITY;
    for block in 0..=MOST_BLOCKS {
        for ((row, costs), f) in plan.chunks_exact_mut(n).zip(costs.chunks_exact(n)).zip(&f) {
            for ((entry, cost), g) in row.iter_mut().zip(costs).zip(&g) {
                *entry = ((f + g - cost) / epsilon).exp() * weight * weight;
            }
        }
        let ones = vec![1.0; n];
        let off = |sums: &[f64]| sums.iter().map(|sum| (sum - weight).abs()).sum::<f64>();
        if block > 0 {
            columns(&plan, &ones, &mut sums);
            error = off(&sums);
            if symmetric {
                rows(&plan, &ones, &mut sums);
                error += off(&sums);
            }
            if error < threshold {
                let mass: f64 = plan.iter().sum();
                return Ok((f.iter().sum::<f64>() + g.iter().sum::<f64>()) * weight + epsilon * (1.0 - mass));
            }
        }
        if error.is_nan() {
            break;
        }
        let (mut u, mut v) = (ones.clone(), ones);
        for _ in 0..BLOCK {
            if symmetric {
                // With f = g, the mean of the old and the new potential converges faster than alternating updates.
                rows(&plan, &u, &mut sums);
                u.iter_mut().zip(&sums).for_each(|(u, sum)| *u = (*u * weight / sum).sqrt());
            } else {
                columns(&plan, &u, &mut sums);
                v.iter_mut().zip(&sums).for_each(|(v, sum)| *v = weight / sum);
                rows(&plan, &v, &mut sums);
                u.iter_mut().zip(&sums).for_each(|(u, sum)| *u = weight / sum);
            }
        }
        let v = if symmetric { &u } else { &v };
        f.iter_mut().zip(&u).for_each(|(f, u)| *f += epsilon * u.ln());
        g.iter_mut().zip(v).for_each(|(g, v)| *g += epsilon * v.ln());
    }
    Err(NotConverged { particles: n, error })
}

/// sum_j P_ij v_j.
fn rows(plan: &[f64], v: &[f64], sums: &mut [f64]) {
    const LANES: usize = 8;
    for (row, sum) in plan.chunks_exact(v.len()).zip(sums) {
        let mut lanes = [0.0; LANES];
        let (entries, scalings) = (row.chunks_exact(LANES), v.chunks_exact(LANES));
        let rest: f64 = entries.remainder().iter().zip(scalings.remainder()).map(|(p, v)| p * v).sum();
        for (entries, scalings) in entries.zip(scalings) {
            for lane in 0..LANES {
                lanes[lane] += entries[lane] * scalings[lane];
            }
        }
        *sum = lanes.iter().sum::<f64>() + rest;
    }
}

/// sum_i P_ij u_i.
fn columns(plan: &[f64], u: &[f64], sums: &mut [f64]) {
    sums.fill(0.0);
    for (row, u) in plan.chunks_exact(u.len()).zip(u) {
        sums.iter_mut().zip(row).for_each(|(sum, p)| *sum += p * u);
    }
}
