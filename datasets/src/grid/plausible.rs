//! Plausibility check of the values of maps and surveys. A value that can be neither an anomaly nor a total field of
//! the earth is an error, unless the options accept it.

use schemas::plausible::{PhysicalQuantity, PlausibilityCheck, PlausibleRange, shown, survey};

use super::markers::GAP;
use crate::ReadError;

/// The note on values of the total field.
const TOTAL_FIELD: &str =
    "the values are a total field, not an anomaly; subtract the core field if an anomaly is required";

/// Whether impossible values are accepted.
pub(crate) fn accepted(accept: &[PlausibilityCheck]) -> bool {
    accept.contains(&PlausibilityCheck::Range)
}

/// A number, spelt as in an option.
pub(crate) fn number(value: f64) -> String {
    let plain = value == 0.0 || (1e-4..1e15).contains(&value.abs());
    if plain { value.to_string() } else { format!("{value:e}") }
}

/// The unit of values before their conversion to nT or a unit of a derivative.
pub(crate) struct ValueUnit<'a> {
    /// Name.
    pub(crate) name: &'a str,
    /// The factor that converts to `canonical`.
    pub(crate) factor: f64,
    /// `nT`, or the unit of a derivative.
    pub(crate) canonical: &'static str,
}

/// Rejects impossible values. `wrong` makes the error from a value's index and a message.
///
/// # Errors
/// Fails for values outside the limits of an anomaly (of a total field, if most values are total fields). Also fails if
/// the largest value is far above the next value and is a usual marker: only nines, such as 9999, or 32767.
pub(crate) fn check(
    values: &[f64],
    unit: &ValueUnit,
    notes: &mut Vec<String>,
    wrong: impl Fn(usize, String) -> ReadError,
) -> Result<(), ReadError> {
    let scaled = |v: f64| v * unit.factor;
    let limits = survey(values.iter().map(|v| scaled(*v)));
    if limits.kind == PhysicalQuantity::TotalField && unit.canonical == "nT" {
        notes.push(TOTAL_FIELD.to_owned());
    }
    let mut outside = values.iter().enumerate().filter(|(_, v)| !v.is_nan() && !limits.holds(scaled(**v)));
    let Some((first, value)) = outside.next() else { return nines(values, unit, wrong) };
    let (count, known) = (outside.count(), values.iter().filter(|v| !v.is_nan()).count());
    let noun = match unit.canonical {
        "nT" => limits.kind.noun(),
        _ => "a derivative of a magnetic anomaly",
    };
    let found = if unit.factor == 1.0 {
        format!("{} {}", spelt(*value), unit.canonical)
    } else {
        format!("{} {} ({} {})", spelt(*value), unit.name, spelt(scaled(*value)), unit.canonical)
    };
    let PlausibleRange { low, high, .. } = limits;
    let mut what = format!("{found} is not {noun} ({} to {} {})", shown(low), shown(high), unit.canonical);
    if count > 0 {
        what += &format!("; other values out of range: {count} of {known}");
    }
    Err(wrong(first, what).help(remedy(*value)))
}

/// Rejects a marker such as 9999 that is within the limits but far above all other values.
fn nines(values: &[f64], unit: &ValueUnit, wrong: impl Fn(usize, String) -> ReadError) -> Result<(), ReadError> {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let next = values.iter().copied().filter(|v| *v < most).fold(f64::NEG_INFINITY, f64::max);
    let text = number(most);
    let usual = text.len() > 3 && text.bytes().all(|b| b == b'9') || most == 32_767.0;
    if !usual || next.is_infinite() || most - next < GAP {
        return Ok(());
    }
    let first = values.iter().position(|v| *v == most).unwrap_or(0);
    let what = format!("{} {} is far above the next largest value, {}", spelt(most), unit.name, spelt(next));
    Err(wrong(first, what).help(remedy(most)))
}

fn remedy(value: f64) -> String {
    let text = number(value);
    format!(
        "if {text} marks a missing value, set `missing = [{text}]` in the table of the spec or use `--missing={text}`; \
         set `accept = [\"range\"]` or use `--accept range` to keep the values"
    )
}

fn spelt(x: f64) -> String {
    if x.is_finite() { shown(x) } else { x.to_string() }
}
