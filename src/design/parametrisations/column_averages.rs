//! Walls that are linear in their variables, and the least-squares fit of the variables to a wall.

/// The polygon that stands for a wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    /// x of its vertices.
    pub x: Vec<f64>,
    /// The distance of its vertices, if it keeps the wall's area from vertex to vertex, with its first moment. (Else its vertices lie on the wall.)
    ///
    /// A kink between two vertices is cut off where both lie on the wall, up to dx/8 times the change of the slope. One that is a spacing beside
    /// the edge of a hot wall then changes the heat as if the edge were elsewhere, by 0.08 spacings for a slope of 1.
    pub keeps_area: Option<f64>,
}

impl Polygon {
    /// The height of the vertex at `x`: that of the wall f(x), and the integral of phi (f - I f)/dx with the hat function phi of the vertex and
    /// the straight lines I f between the wall's heights at the vertices.
    fn height(&self, wall: &dyn Fn(f64) -> f64, x: f64) -> f64 {
        /// Pieces from vertex to vertex, each with one point: 5e-4 dx of a change of the slope is left out at most.
        const PIECES: usize = 16;
        let here = wall(x);
        let Some(dx) = self.keeps_area else { return here };
        let half = |side: f64| {
            let there = wall(x + side * dx);
            let piece = |k: usize| {
                let t = (k as f64 + 0.5) / PIECES as f64;
                (1.0 - t) * (wall(x + side * t * dx) - (1.0 - t) * here - t * there)
            };
            (0..PIECES).map(piece).sum::<f64>() / PIECES as f64
        };
        here + half(-1.0) + half(1.0)
    }
}

/// A linear map from variables to column averages as a sparse matrix, and its adjoint.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnAverages {
    variables: usize,
    /// Pairs (variable, weight) of each column.
    weights: Vec<Vec<(usize, f64)>>,
}

impl ColumnAverages {
    pub fn new(variables: usize, weights: Vec<Vec<(usize, f64)>>) -> Self {
        Self { variables, weights }
    }

    /// The map to the heights of a polygon instead of column averages; `height` must be linear in the variables.
    pub fn of_polygon(variables: usize, polygon: &Polygon, height: impl Fn(&[f64], f64) -> f64) -> Self {
        let mut weights = vec![vec![]; polygon.x.len()];
        for k in 0..variables {
            let mut unit = vec![0.0; variables];
            unit[k] = 1.0;
            for (weights, &x) in weights.iter_mut().zip(&polygon.x) {
                let weight = polygon.height(&|x| height(&unit, x), x);
                if weight != 0.0 {
                    weights.push((k, weight));
                }
            }
        }
        Self { variables, weights }
    }

    /// The same map for each of two walls, whose variables and columns follow each other.
    pub fn twice(&self) -> Self {
        let other = self.weights.iter().map(|pairs| pairs.iter().map(|(k, w)| (k + self.variables, *w)).collect());
        Self { variables: 2 * self.variables, weights: self.weights.iter().cloned().chain(other).collect() }
    }

    /// `[K]` -> `[C]`.
    pub fn heights(&self, variables: &[f64]) -> Vec<f64> {
        self.weights.iter().map(|w| w.iter().map(|(k, w)| w * variables[*k]).sum()).collect()
    }

    /// `[C]` -> `[K]`, summed in the order of the columns.
    pub fn pull_back(&self, heights_bar: &[f64]) -> Vec<f64> {
        let mut gradient = vec![0.0; self.variables];
        for (weights, bar) in self.weights.iter().zip(heights_bar) {
            for (k, w) in weights {
                gradient[*k] += w * bar;
            }
        }
        gradient
    }
}

/// Number of steps of the conjugate gradients in [`fitted`], as a multiple of the number of variables.
const FIT_STEPS: usize = 4;

/// Variables whose heights are nearest to given ones by least squares, and among these, if heights are few, nearest to
/// `first`. Heights that the map made give their variables back up to rounding if every variable affects a height. The
/// method is conjugate gradients for least squares (Björck 1996, algorithm 7.4.1).
pub(super) fn fitted(map: &ColumnAverages, heights: &[f64], first: Vec<f64>) -> Vec<f64> {
    let square = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
    let mut variables = first;
    let mut residual: Vec<f64> = map.heights(&variables).iter().zip(heights).map(|(y, o)| o - y).collect();
    let mut slope = map.pull_back(&residual);
    let mut direction = slope.clone();
    let (mut norm, begin) = (square(&slope), square(&slope));
    for _ in 0..FIT_STEPS * variables.len() {
        if norm <= 1e-32 * begin || norm == 0.0 {
            break;
        }
        let moved = map.heights(&direction);
        let step = norm / square(&moved);
        variables.iter_mut().zip(&direction).for_each(|(c, d)| *c += step * d);
        residual.iter_mut().zip(&moved).for_each(|(r, m)| *r -= step * m);
        slope = map.pull_back(&residual);
        let before = std::mem::replace(&mut norm, square(&slope));
        direction.iter_mut().zip(&slope).for_each(|(d, s)| *d = s + norm / before * *d);
    }
    variables
}
