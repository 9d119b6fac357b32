//! Markers of unknown nodes: markers in the file or the options, and values too large for any field.

use super::plausible::number;

/// Markers that programs write without a header entry, of either sign: the largest single-precision number, Surfer's
/// blank, the default of NetCDF, Geosoft's dummy, the largest double-precision number.
const DUMMIES: [f64; 5] = [f32::MAX as f64, 1.701_41e38, 9.969_209_968_386_869e36, 1e32, f64::MAX];

/// Relative tolerance for a marker that is too large for any field: a text file may give only six of its digits.
const SIX_DIGITS: f64 = 1e-5;

/// Numbers of this magnitude or larger cannot be a field in any unit.
const BEYOND: f64 = 1e30;

/// Whether a value is the marker: exactly, in single precision, or, for a marker too large for any field, to six
/// digits.
pub(crate) fn is_marker(value: f64, marker: f64) -> bool {
    value == marker
        || (value as f32 == marker as f32 && (marker as f32).is_finite())
        || (marker.abs() >= BEYOND && marker.is_finite() && ((value - marker) / marker).abs() < SIX_DIGITS)
}

/// Whether a value is one of the usual markers that are too large for any field.
pub(crate) fn is_dummy(value: f64) -> bool {
    value.abs() >= BEYOND && value.is_finite() && DUMMIES.iter().any(|d| is_marker(value.abs(), *d))
}

/// Usual dummy values of integer files and text tables.
const USUAL: [f64; 6] = [-9999.0, -99_999.0, -999_999.0, -9_999_999.0, -99_999_999.0, -32_768.0];

/// A usual dummy is recognised only if it lies below all other values by this distance, in the unit of the values.
pub(super) const GAP: f64 = 1000.0;

/// Replaces markers by NaN: those of `given`, infinities, [`is_dummy`], and a usual dummy that is the lowest value and
/// far below the next. Notes count the replaced values, except those of markers in `given`.
pub(crate) fn without_markers(values: &mut [f64], given: &[f64], usual: bool, notes: &mut Vec<String>) {
    let mut infinite = 0_usize;
    let mut dummies: Vec<(f64, usize)> = vec![];
    for value in values.iter_mut().filter(|v| !v.is_nan()) {
        let v = *value;
        if v.is_infinite() {
            infinite += 1;
        } else if is_dummy(v) {
            match dummies.iter_mut().find(|(d, _)| *d == v) {
                Some((_, count)) => *count += 1,
                None => dummies.push((v, 1)),
            }
        } else if !given.iter().any(|marker| is_marker(v, *marker)) {
            continue;
        }
        *value = f64::NAN;
    }
    if infinite > 0 {
        notes.push(format!("{infinite} infinite values are treated as unknown"));
    }
    notes.extend(dummies.iter().map(|(value, count)| taken(*value, *count)));
    while usual && without_usual(values, notes) {}
}

fn without_usual(values: &mut [f64], notes: &mut Vec<String>) -> bool {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let next = values.iter().copied().filter(|v| *v > least).fold(f64::INFINITY, f64::min);
    if !USUAL.contains(&least) || next - least < GAP {
        return false;
    }
    let mut count = 0;
    for value in values.iter_mut().filter(|v| **v == least) {
        *value = f64::NAN;
        count += 1;
    }
    notes.push(taken(least, count));
    true
}

fn taken(value: f64, count: usize) -> String {
    format!("{count} values of {} are treated as unknown", number(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_markers_in_both_precisions() {
        let low = f64::from(f32::MIN);
        for (value, marker) in [
            (low, -3.402_823_466_385_288_6e38),
            (-3.402823e38, low),
            (-3.40282e38, low),
            (f64::from(1e20_f32), 1e20),
            (1.701_411_733_192_645e38, 1.701_41e38),
            (f64::from(-999.9_f32), -999.9),
            (-9999.0, -9999.0),
        ] {
            assert!(is_marker(value, marker) && is_marker(marker, value), "{value} {marker}");
        }
        for (value, marker) in [(-9998.9, -9999.0), (1e308, 1.797e308), (0.001, 0.0), (1e20, 2e20), (f64::NAN, 5.0)] {
            assert!(!is_marker(value, marker), "{value} {marker}");
        }
        assert!(is_dummy(-1e32) && is_dummy(f64::MIN) && !is_dummy(1e308) && !is_dummy(99_999.0));
    }

    #[test]
    fn unit_markers_become_unknown_and_are_counted() {
        let mut values = [1.0, -9999.0, -99_999.0, f64::INFINITY, 1.701_41e38, 7.0, 2.0];
        let mut notes = vec![];
        without_markers(&mut values, &[7.0], true, &mut notes);
        assert_eq!(values.iter().filter(|v| v.is_nan()).count(), 5);
        assert_eq!(notes.len(), 4, "{notes:?}");
        // A value of -9999 nT next to -9500 nT may be an anomaly.
        let mut values = [-9999.0, -9500.0, 3.0];
        without_markers(&mut values, &[], true, &mut notes);
        assert!(values.iter().all(|v| !v.is_nan()));
    }
}
