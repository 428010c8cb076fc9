//! The references that come with the program: `data/reference`, whose README has their origin.

/// Columns of numbers under a header; lines that begin with `#` are comments.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// Of a CSV text that comes with the program.
    fn of(text: &str) -> Self {
        let mut lines = text.lines().filter(|line| !line.starts_with('#') && !line.is_empty());
        let cells = |line: &str| line.split(',').map(|cell| cell.trim().to_string()).collect::<Vec<_>>();
        let names = lines.next().map(cells).unwrap_or_default();
        Self { names, rows: lines.map(cells).collect() }
    }

    /// A column's numbers; not a number where there is none.
    pub fn column(&self, name: &str) -> Vec<f64> {
        let Some(k) = self.names.iter().position(|other| other == name) else { return vec![] };
        self.rows.iter().map(|row| row.get(k).and_then(|cell| cell.parse().ok()).unwrap_or(f64::NAN)).collect()
    }

    /// A column's cells.
    pub fn texts(&self, name: &str) -> Vec<&str> {
        let Some(k) = self.names.iter().position(|other| other == name) else { return vec![] };
        self.rows.iter().map(|row| row.get(k).map_or("", String::as_str)).collect()
    }
}

/// `time`, `kinetic_energy` (mean over the box) at Re = 50: a Fourier-Galerkin method.
pub fn taylor_green_3d() -> Table {
    Table::of(include_str!("../../data/reference/taylor-green-3d.csv"))
}

/// `s`, `u` on x = 1/2 and `v` on y = 1/2 at Re = 100: finite differences.
pub fn lid_driven_cavity() -> Table {
    Table::of(include_str!("../../data/reference/lid-driven-cavity.csv"))
}

/// Places near the extrema of u and v (twice) in a cubic cavity, and the values there of 36 and 54 cells a side, extrapolated.
pub const CUBIC_CAVITY: [(f64, f64); 3] = [(0.4531, -0.215), (0.2344, 0.151), (0.8047, -0.250)];

/// The same on z = 1/2 of a cubic cavity.
pub fn lid_driven_cavity_3d() -> Table {
    Table::of(include_str!("../../data/reference/lid-driven-cavity-3d.csv"))
}

/// `T`, `Z`: Martin and Moyce (1952).
pub fn dam_break_front() -> Table {
    Table::of(include_str!("../../data/reference/dam-break-front.csv"))
}

/// `shape`, `A`, `o0` ... `o24` of walls at H = 0.2. (Its `Q` is 0.02 to 0.1 % off: [`heated_channel_outflow`] has sharper ones.)
pub fn heated_channel() -> Table {
    Table::of(include_str!("../../data/reference/fem-shapes-H0.2.csv"))
}

/// Heat that flows out over a wall of [`heated_channel`]: finite elements on graded meshes.
pub fn heated_channel_outflow(shape: &str, amplitude: f64) -> Option<f64> {
    let table = Table::of(include_str!("../../data/reference/fem-sharp.csv"));
    let (names, amplitudes, heights) = (table.texts("shape"), table.column("A"), table.column("H"));
    let row = (0..names.len()).find(|&k| names[k] == shape && amplitudes[k] == amplitude && heights[k] == 0.2);
    row.map(|row| table.column("Q")[row])
}

/// dQ/d offset of the flat wall at x = 0.26, 0.28 ... 0.74, H = 0.2, in 1e-3: finite elements.
pub const HEATED_CHANNEL_GRADIENT: [f64; 25] = [
    8.2, 2.1, 0.1, -0.6, -1.0, -1.2, -1.3, -1.4, -1.5, -1.5, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.6, -1.5,
    -1.3, -1.1, -0.6, 0.2, 2.3, 8.5,
];

/// Value of a piecewise linear curve.
pub fn between(x: &[f64], y: &[f64], at: f64) -> f64 {
    let right = x.partition_point(|x| *x < at).clamp(1, x.len() - 1);
    let share = (at - x[right - 1]) / (x[right] - x[right - 1]);
    y[right - 1] + share * (y[right] - y[right - 1])
}
