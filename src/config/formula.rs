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

type Expression = FlatEx<f64, FloatOpsFactory<f64>, Literal>;

#[derive(Debug, Clone)]
pub struct Function {
    expression: Expression,
    /// 0, 1, 2, 3 for x, y, z, t, in the order of the expression's variables.
    variables: Vec<usize>,
}

impl Formula {
    /// Parses a formula of the place; `key` is its key in messages, such as `shapes[2].temperature`.
    ///
    /// # Errors
    /// An invalid expression, or one with other variables than x, y, z (z only in three dimensions).
    pub fn function(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        let place = ["x", "y", "z"].into_iter().take(dimension).enumerate();
        self.read(key, place.collect(), &format!("a place in {dimension} dimensions"))
    }

    /// Reads an expression of the place and of the time t.
    pub fn function_of_time(&self, key: &str, dimension: usize) -> Result<Function, BadInput> {
        let place = ["x", "y", "z"].into_iter().take(dimension).enumerate();
        self.read(key, place.chain([(3, "t")]).collect(), &format!("a place in {dimension} dimensions and a time"))
    }

    fn read(&self, key: &str, names: Vec<(usize, &str)>, what: &str) -> Result<Function, BadInput> {
        let bad = |problem: String| BadInput::at(key, format!("{key} = \"{}\": {problem}", self.0)).allowed(ALLOWED);
        let expression = Expression::parse(&self.0).map_err(|error| bad(error.to_string()))?;
        let number = |name: &String| names.iter().find(|(_, known)| known == name).map(|(k, _)| *k).ok_or(name.clone());
        let variables = expression.var_names().iter().map(number).collect::<Result<Vec<_>, _>>();
        let variables = variables.map_err(|name| {
            let known: Vec<&str> = names.iter().map(|(_, name)| *name).collect();
            bad(format!("`{name}` is unknown; {what} has {}", known.join(", ")))
        })?;
        Ok(Function { expression, variables })
    }
}

impl Function {
    /// The value at a position; NaN where it has none.
    pub fn at(&self, place: [f64; 3]) -> f64 {
        self.at_time(place, 0.0)
    }

    /// Its value at a place and a time; not a number where it has none.
    pub fn at_time(&self, [x, y, z]: [f64; 3], t: f64) -> f64 {
        let values: Vec<f64> = self.variables.iter().map(|&k| [x, y, z, t][k]).collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str, place: [f64; 3]) -> f64 {
        Formula(text.into()).function("key", 3).unwrap_or_else(|bad| panic!("{bad}")).at(place)
    }

    #[test]
    fn formulas_are_what_they_look_like() {
        let p = [0.5, -2.0, 3.0];
        for (text, expected) in [
            ("3", 3.0),
            ("-1.5e-3", -1.5e-3),
            ("x", 0.5),
            ("z - y - x", 4.5),
            ("z/x/2*y", -6.0),
            ("2 + 3*x^2", 2.75),
            ("1.5*y*(1 - y)", -9.0),
            ("sin(PI*x)", 1.0),
            ("max(min(x, z), 0)", 0.5),
            ("exp(-((x-0.5)^2 + y^2))", (-4.0f64).exp()),
            ("1 + (signum(y) + 1)/2", 1.0),
            ("0 - x^2", -0.25),
        ] {
            assert!((value(text, p) - expected).abs() < 1e-14, "{text}: {} is not {expected}", value(text, p));
        }
        // As documented.
        assert_eq!(value("-x^2", p), 0.25);
        assert!(value("sqrt(y)", p).is_nan() && value("1/(x - 0.5)", p).is_infinite());
    }

    #[test]
    fn what_is_no_formula_is_an_error_that_shows_it() {
        for text in
            ["", "1 +", "sni(x)", "(x", "x)", "2 x", "a*x", "x = 3", "t", "x;y", "\"", "1,2", "sin()", "max(1,2,3)"]
        {
            let bad = Formula(text.into()).function("initial.velocity[1]", 2).map(|_| ()).expect_err(text);
            let message = bad.to_string();
            assert!(message.starts_with(&format!("initial.velocity[1] = \"{text}\"")), "{message}");
            assert!(message.contains("allowed: a number, or a formula"), "{message}");
            assert!(bad.is_about("initial.velocity[1]"));
        }
        let flat = Formula("z".into()).function("k", 2).unwrap_err().to_string();
        assert!(flat.contains("`z` is unknown; a place in 2 dimensions has x, y"), "{flat}");
    }

    /// The parser may reject a text, but must not panic.
    #[test]
    fn no_text_panics() {
        let parts =
            ["x", "y", "(", ")", "+", "-", "*", "/", "^", "sin", "max", ",", "1", ".", "e", "PI", " ", "é", "{", "}"];
        let mut seed = 1_u64;
        let mut read = 0;
        for _ in 0..20_000 {
            let mut text = String::new();
            for _ in 0..seed % 9 {
                seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                text.push_str(parts[(seed >> 33) as usize % parts.len()]);
            }
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407) ^ (seed >> 17);
            if let Ok(function) = Formula(text).function("k", 3) {
                function.at([0.1, 0.2, 0.3]);
                read += 1;
            }
        }
        assert!(read > 100, "only {read} of them are formulas");
    }

    #[test]
    fn numbers_stay_numbers() {
        #[derive(Serialize, Deserialize, PartialEq, Debug)]
        struct Holder {
            a: Vec<Formula>,
        }
        let holder: Holder = toml::from_str("a = [1, 0.25, \"x\", \"0.10\"]").unwrap();
        let text = toml::to_string(&holder).unwrap();
        assert_eq!(text.trim(), "a = [1.0, 0.25, \"x\", \"0.10\"]");
        assert_eq!(toml::from_str::<Holder>(&text).unwrap(), holder);
        assert!(toml::from_str::<Holder>("a = [true]").unwrap_err().to_string().contains("a number or a formula"));
    }
}
