//! Values with a notation of their own, which a file may write as text or as a number.

use serde::de::{Deserializer, Error, Unexpected, Visitor};
use std::fmt;

/// A value as it was written.
pub enum Written<'a> {
    Text(&'a str),
    Whole(i64),
    Number(f64),
}

/// Reads a value. `form` says in messages what is expected; `read` returns none for what it does not expect.
pub fn read<'de, D: Deserializer<'de>, T>(
    deserializer: D,
    form: &'static str,
    read: impl Fn(Written) -> Option<Result<T, String>>,
) -> Result<T, D::Error> {
    deserializer.deserialize_any(Reads { form, read })
}

struct Reads<F> {
    form: &'static str,
    read: F,
}

impl<T, F: Fn(Written) -> Option<Result<T, String>>> Visitor<'_> for Reads<F> {
    type Value = T;

    fn expecting(&self, out: &mut fmt::Formatter) -> fmt::Result {
        out.write_str(self.form)
    }
    fn visit_str<E: Error>(self, text: &str) -> Result<T, E> {
        let found = (self.read)(Written::Text(text));
        found.ok_or_else(|| E::invalid_value(Unexpected::Str(text), &self))?.map_err(E::custom)
    }
    fn visit_i64<E: Error>(self, number: i64) -> Result<T, E> {
        let found = (self.read)(Written::Whole(number));
        found.ok_or_else(|| E::invalid_type(Unexpected::Signed(number), &self))?.map_err(E::custom)
    }
    fn visit_f64<E: Error>(self, number: f64) -> Result<T, E> {
        let found = (self.read)(Written::Number(number));
        found.ok_or_else(|| E::invalid_type(Unexpected::Float(number), &self))?.map_err(E::custom)
    }
}
