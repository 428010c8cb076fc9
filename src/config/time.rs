//! The section `[time]`.

use crate::config::range::{
    Range::{Above, Positive, Within},
    MAX_STEPS,
};
use crate::config::section::section;
use serde::{Deserialize, Serialize};

section! {
    "time.": Time {
        end: f64 = 2.5, Positive;
        #[serde(skip_serializing_if = "Option::is_none")]
        steps: Option<usize> = None, Within(1.0, MAX_STEPS);
        #[serde(skip_serializing_if = "Option::is_none")]
        step: Option<f64> = None, Positive;
        #[serde(deserialize_with = "crate::config::stability::cfl")]
        cfl: f64 = 1.5, Above(0.0, 4.0);
        diffusion_number: f64 = 0.25, Above(0.0, 1.0);
        adaptive: bool = false;
        start: Start = Start::Developed;
        jitter: f64 = 0.05, Within(0.0, 0.3);
        skin: f64 = 0.2, Above(0.0, 2.0);
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    Rest,
    Developed,
}
