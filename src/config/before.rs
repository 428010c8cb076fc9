//! Old keys, from before the section `[method]` existed. Files, run folders, data sets and models that have them are
//! read as if they had the present ones. `fluid.formulation` (consistent or standard) and `fluid.motion` (moving or
//! fixed) chose the method, and the keys of all methods were in `fluid` and `time`.

use crate::config::method::Method;
use crate::error::BadInput;

/// The old keys that chose the method, and their values.
const CHOICES: [(&str, [&str; 2]); 2] =
    [("fluid.formulation", ["consistent", "standard"]), ("fluid.motion", ["moving", "fixed"])];

/// The old keys of methods, whose last parts have not changed.
const KEYS: [&str; 18] = [
    "fluid.background_pressure_factor",
    "fluid.transport_velocity",
    "fluid.artificial_viscosity",
    "fluid.artificial_viscosity_pairs",
    "fluid.density_equation",
    "fluid.density_renormalisation",
    "fluid.flux",
    "fluid.density_diffusion",
    "fluid.density_gradient",
    "fluid.velocity_diffusion",
    "fluid.riemann_limiter",
    "fluid.equation_of_state_exponent",
    "fluid.shift",
    "fluid.shift_strength",
    "fluid.pressure_diffusion",
    "time.integrator",
    CHOICES[0].0,
    CHOICES[1].0,
];

/// The present name of an old key; none for present keys.
pub fn today(key: &str) -> Option<String> {
    let own = KEYS.contains(&key).then(|| key.split_once('.').map_or(key, |(_, own)| own))?;
    Some(if CHOICES.iter().any(|(choice, _)| *choice == key) { "method.name".into() } else { format!("method.{own}") })
}

/// Whether the keys are those of a complete old configuration, which has keys of methods that it does not choose.
pub fn is_complete(keys: &[&str]) -> bool {
    ["fluid.formulation", "fluid.background_pressure_factor", "fluid.shift_strength"]
        .iter()
        .all(|key| keys.contains(key))
}

/// Whether an old key was ignored, rather than refused, by methods that lack it.
pub fn had_no_effect(key: &str, value: &str) -> bool {
    match key {
        "time.integrator" => value == "symplectic-euler",
        _ => key.starts_with("fluid.shift") || key == "fluid.pressure_diffusion",
    }
}

/// The method that an old choice gives if the method `now` was chosen before.
///
/// # Errors
/// An unknown choice, and fixed particles of the standard method, which do not exist.
pub fn chosen(key: &str, value: &str, now: &str) -> Result<String, BadInput> {
    let allowed = CHOICES.iter().find(|(choice, _)| *choice == key).map_or(["", ""], |(_, values)| *values);
    let bad = |problem: String| Err(BadInput::at("method.name", problem).allowed(Method::names().join(", ")));
    let fixed = [value, now].contains(&"fixed");
    match value {
        _ if !allowed.contains(&value) => bad(format!("{key} = {value}, which was {}", allowed.join(" or "))),
        _ if fixed && [value, now].contains(&"standard") => {
            bad(format!("{key} = {value} where the method is {now}: particles of the standard method move"))
        }
        "consistent" if now != "standard" => Ok(now.into()),
        "moving" if now != "fixed" => Ok(now.into()),
        "moving" => Ok("consistent".into()),
        _ => Ok(value.into()),
    }
}

/// Values of keys that are missing in files from before methods could be chosen.
pub const FIRST: [(&str, &str); 3] =
    [("method.name", "standard"), ("resolution.smoothing_length", "1.0"), ("optimise.method", "adam")];

/// Renames the old keys of a recorded configuration, which is complete, and drops those of methods that it did not
/// choose.
pub fn translate(record: &mut toml::Table) {
    // The channel in three dimensions is newer than the choice of methods.
    let young = record.get("scene").and_then(toml::Value::as_str) == Some("heated-channel-3d");
    if record.contains_key("method") {
        return;
    }
    let mut taken: Vec<(&str, toml::Value)> = Vec::new();
    for (section, own) in KEYS.iter().filter_map(|key| key.split_once('.')) {
        let section = record.get_mut(section).and_then(toml::Value::as_table_mut);
        taken.extend(section.and_then(|section| section.remove(own)).map(|value| (own, value)));
    }
    let text = |own: &str| taken.iter().find(|(key, _)| *key == own).and_then(|(_, value)| value.as_str());
    let name = match (text("formulation"), text("motion")) {
        (None, _) if !young => "standard",
        (Some("standard"), _) => "standard",
        (_, Some("fixed")) => "fixed",
        _ => "consistent",
    };
    if text("formulation").is_none() && !young {
        let first =
            [("resolution", "smoothing_length", toml::Value::Float(1.0)), ("optimise", "method", "adam".into())];
        for (section, key, value) in first {
            let section = record.entry(section).or_insert_with(|| toml::Table::new().into());
            section.as_table_mut().map(|section| section.entry(key).or_insert(value));
        }
    }
    let own = Method::keys_of(name);
    let mut method: toml::Table = taken
        .iter()
        .filter(|(key, _)| own.iter().any(|own| own == key))
        .map(|(key, value)| (key.to_string(), value.clone()))
        .collect();
    method.insert("name".into(), name.into());
    record.insert("method".into(), method.into());
}
