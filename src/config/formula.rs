//! Numbers that depend on the position: expressions of x, y and z in a configuration, parsed by the crate exmex.

use crate::config::notation::{self, Written};
use crate::error::BadInput;
use exmex::{literal_matcher_from_pattern, Express, FlatEx, FloatOpsFactory, MatchLiteral};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The elements of formulas, for messages.
pub const ALLOWED: &str =
    "a number, or a formula in quotes: x, y, z, + - * / ^ ( ), PI, abs(), sqrt(), sin(), exp(), tanh(), \
                           signum(), min(a, b), max(a, b) (a nested one first: max(min(a, b), c)) and the like";

/// An expression of x, y, z, or a number. A leading minus belongs to what follows it: -x^2 is (-x)^2. Of two nested min
/// or max the inner one must be the first argument (exmex rejects the other order).
#[derive(Debug, Clone, PartialEq)]
pub struct Formula(pub String);

// Numbers may have exponents.
literal_matcher_from_pattern!(Literal, r"^([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?");

/// How a formula is read, given its key in messages and the number of dimensions.
pub type ReadFormula = fn(&Formula, &str, usize) -> Result<Function, BadInput>;

/// The largest number of a shape's parameters, p0, p1, ..., behind the variables of place and time.
const PARAMETERS: usize = 1024;

/// The variable of a parameter's name.
fn parameter(name: &str) -> Option<usize> {
    let number: usize = name.strip_prefix('p')?.parse().ok()?;
    (number < PARAMETERS).then_some(4 + number)
}

type Expression = FlatEx<f64, FloatOpsFactory<f64>, Literal>;

#[derive(Debug, Clone)]
pub struct Function {
    expression: Expression,
    /// 0, 1, 2, 3 for x, y, z, t, then parameters, in the order of the expression's variables.
    variables: Vec<usize>,
}

/// The names of the components of a place.
fn place(dimension: usize) -> impl Iterator<Item = (usize, &'static str)> {
    ["x", "y", "z"].into_iter().take(dimension).enumerate()
}

impl Formula {
    /// Parses a formula of the place; `key` is its key in messages, such as `shapes[2].temperature`.
    ///
    /// # Errors
    /// An invalid expression, or one with other variables than x, y, z (z only in three dimensions).
    pub fn function(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        self.read(key, place(dimension).collect(), false, &format!("a place in {dimension} dimensions"))
    }

    /// Reads an expression of the place and of the time t.
    pub fn function_of_time(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        self.read(
            key,
            place(dimension).chain([(3, "t")]).collect(),
            false,
            &format!("a place in {dimension} dimensions and a time"),
        )
    }

    /// Reads an expression of the place and of the parameters of a shape.
    pub fn function_of_parameters(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        self.read(key, place(dimension).collect(), true, &format!("a place in {dimension} dimensions"))
    }

    /// Reads an expression of the place, of the time and of the parameters of a shape.
    pub fn function_of_all(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        let names = place(dimension).chain([(3, "t")]).collect();
        self.read(key, names, true, &format!("a place in {dimension} dimensions and a time"))
    }

    /// Reads an expression of the parameters of a shape alone.
    pub fn function_of_numbers(&self, key: &str) -> Result<Function, BadInput> {
        self.read(key, vec![], true, "a number")
    }

    fn read(
        &self,
        key: &str,
        names: Vec<(usize, &str)>,
        has_parameters: bool,
        what: &str,
    ) -> Result<Function, BadInput> {
        let bad = |problem: String| BadInput::at(key, format!("{key} = \"{}\": {problem}", self.0)).allowed(ALLOWED);
        let expression = Expression::parse(&self.0).map_err(|error| bad(error.to_string()))?;
        let number = |name: &String| {
            let known = names.iter().find(|(_, known)| known == name).map(|(k, _)| *k);
            known.or(parameter(name).filter(|_| has_parameters)).ok_or(name.clone())
        };
        let variables = expression.var_names().iter().map(number).collect::<Result<Vec<_>, _>>();
        let variables = variables.map_err(|name| {
            let mut known: Vec<&str> = names.iter().filter(|(k, _)| *k < 4).map(|(_, name)| *name).collect();
            if known.is_empty() {
                known.push("p0, p1, ... of a shape");
            }
            bad(format!("`{name}` is unknown; {what} has {}", known.join(", ")))
        })?;
        Ok(Function { expression, variables })
    }
}

impl Function {
    /// Whether it is the same at every place and time.
    pub fn is_constant(&self) -> bool {
        self.variables.is_empty()
    }

    /// Whether it changes with time.
    pub fn has_time(&self) -> bool {
        self.variables.contains(&3)
    }

    /// The value at a position; NaN where it has none.
    pub fn at(&self, place: [f64; 3]) -> f64 {
        self.at_time(place, 0.0)
    }

    /// Its value at a place and a time; not a number where it has none.
    pub fn at_time(&self, place: [f64; 3], t: f64) -> f64 {
        self.with_parameters(place, t, &[])
    }

    /// How many parameters it needs.
    pub fn parameters(&self) -> usize {
        self.variables.iter().map(|k| k.saturating_sub(3)).max().unwrap_or(0)
    }

    /// Its value at a place and a time with parameters; not a number where it has none.
    pub fn with_parameters(&self, [x, y, z]: [f64; 3], t: f64, parameters: &[f64]) -> f64 {
        let value = |k: usize| match k {
            0..4 => [x, y, z, t][k],
            _ => parameters.get(k - 4).copied().unwrap_or(f64::NAN),
        };
        let values: Vec<f64> = self.variables.iter().map(|&k| value(k)).collect();
        self.expression.eval(&values).unwrap_or(f64::NAN)
    }
}

impl From<f64> for Formula {
    fn from(value: f64) -> Self {
        Self(value.to_string())
    }
}

impl Serialize for Formula {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self.0.parse::<f64>() {
            Ok(number) if number.to_string() == self.0 => to.serialize_f64(number),
            _ => to.serialize_str(&self.0),
        }
    }
}

impl<'de> Deserialize<'de> for Formula {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        notation::read(from, "a number or a formula in quotes", |written| {
            Some(Ok(match written {
                Written::Text(text) => Self(text.to_string()),
                Written::Whole(number) => (number as f64).into(),
                Written::Number(number) => number.into(),
            }))
        })
    }
}
