//! Results that the operators of one step share.

/// Results of one operator of a step that later operators and the adjoints reuse.
#[derive(Debug, Default)]
pub struct Kept<R> {
    /// Packed positions and fields, for the derivatives of all fields and for those of the new pressure.
    pub records: Vec<R>,
    pub pressure_records: Vec<R>,
    /// W and F of the pairs of fluid particles.
    pub value: Vec<R>,
    pub slope: Vec<R>,
    /// The factorised matrices of the fits.
    pub factors: Vec<R>,
    /// Fits on the wall's surface: factorised matrices, and the coefficients of all fields and of the new pressure.
    pub wall_factors: Vec<R>,
    pub wall_coefficients: Vec<R>,
    pub pressure_coefficients: Vec<R>,
    /// Coefficients of the derivatives of all fields.
    pub spread: Vec<R>,
    /// For each particle of a chain, its place in the adjacent rows, where the next search begins.
    pub hints: Vec<u32>,
}

impl<R> Kept<R> {
    /// Forgets all results, and keeps their memory.
    pub fn clear(&mut self) {
        let Self { records, pressure_records, value, slope, factors, wall_factors, wall_coefficients, .. } = self;
        let fields = [records, pressure_records, value, slope, factors, wall_factors, wall_coefficients];
        fields.into_iter().for_each(Vec::clear);
        [&mut self.pressure_coefficients, &mut self.spread].into_iter().for_each(Vec::clear);
        self.hints.clear();
    }
}
