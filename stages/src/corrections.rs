//! Corrections of magnetic readings: record of the applied corrections, and check that none is applied twice.

use expressions::Expression;
use schemas::{Column, CorrectionSet, Fault, MagneticCorrection, TableShape, flight};

/// Corrections applied to the reading `name`. Empty if the column is missing.
pub fn had(shape: &TableShape, name: &str) -> CorrectionSet {
    shape.get(name).map(|column| column.removed.clone()).unwrap_or_default()
}

/// Whether a correction has been applied to all readings. `None` if it has been applied to only some.
fn all_had(shape: &TableShape, readings: &[String], correction: MagneticCorrection) -> Option<bool> {
    let mut each = readings.iter().map(|name| had(shape, name).contains(&correction));
    let first = each.next().unwrap_or(false);
    each.all(|other| other == first).then_some(first)
}

/// Whether a stage corrects its readings: `given` if set. Otherwise `default`, but false if any reading already has the
/// correction.
pub fn corrects(
    shape: &TableShape,
    readings: &[String],
    correction: MagneticCorrection,
    given: Option<bool>,
    default: bool,
) -> bool {
    given.unwrap_or(default && all_had(shape, readings, correction) == Some(false))
}

/// Key of a correction, and the setting that switches the correction off.
pub type CorrectionKey = (&'static str, &'static str);
/// Key `remove_core`.
pub const REMOVE_CORE: CorrectionKey = ("remove_core", "set `remove_core = false`");
/// Key `remove_diurnal`.
pub const REMOVE_DIURNAL: CorrectionKey = ("remove_diurnal", "set `remove_diurnal = false`");

/// Key `core_field` of stages that predict or remove the core field.
pub const CORE_FIELD: CorrectionKey = ("core_field", "set `core_field = false`");

/// Fault of a correction that is requested by its key but has already been applied to the readings.
pub fn twice(
    shape: &TableShape,
    readings: &[String],
    correction: MagneticCorrection,
    given: Option<bool>,
    (param, off): CorrectionKey,
) -> Option<Fault> {
    let names = || readings.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let what = match (all_had(shape, readings, correction), given) {
        (Some(true), Some(true)) => {
            format!("{correction} has already been removed from {}, but `{param}` removes it again", names())
        }
        (None, Some(true) | None) => format!("{correction} has been removed from only some of {}", names()),
        (Some(_) | None, _) => return None,
    };
    let help = format!("{off}, or name a reading to which this correction has not been applied");
    Some(Fault::new(what).help(help).of_param(param))
}

/// Note about a default correction that is skipped, because it has already been applied to the readings.
pub fn note(
    shape: &TableShape,
    readings: &[String],
    correction: MagneticCorrection,
    given: Option<bool>,
) -> Option<String> {
    let skipped = given.is_none() && all_had(shape, readings, correction) == Some(true);
    let names = || readings.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    skipped.then(|| format!("{correction} has already been removed from {} and is not removed again", names()))
}

/// Corrections that the value of an expression has had: those of its terms, and those that a subtraction in the
/// expression applies.
///
/// The difference of two readings at the same time contains neither core field nor diurnal variation.
pub fn of_expression(expression: &Expression, shape: &TableShape) -> CorrectionSet {
    let mut removed = CorrectionSet::new();
    let reading = |name: &str| {
        let known = flight::is_scalar_reading(name) || flight::is_compensated(name) || name == "mag_c";
        known || !had(shape, name).is_empty()
    };
    let added: Vec<&str> =
        expression.terms.iter().filter(|(sign, _)| *sign >= 0).map(|(_, name)| name.as_str()).collect();
    added.iter().for_each(|name| removed.extend(had(shape, name)));
    for (sign, name) in &expression.terms {
        match (shape.get(name).and_then(|column| column.correction), *sign) {
            (Some(correction), -1) => {
                removed.insert(correction);
            }
            (Some(correction), 1) if added.iter().any(|other| reading(other)) => {
                removed.remove(&correction);
            }
            (None, -1) if reading(name) && added.iter().any(|other| reading(other)) => {
                removed.extend([MagneticCorrection::Core, MagneticCorrection::Diurnal]);
            }
            _ => {}
        }
    }
    removed
}

/// Copies the corrections of a reading to a column made from it.
pub fn like(column: Column, shape: &TableShape, reading: &str) -> Column {
    column.without(had(shape, reading))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn shape() -> TableShape {
        let names = ["mag_4_uc", "mag_5_uc", "mag_1_igrf", "igrf", "diurnal", "cur_1"];
        let column = |name: &str| {
            let removed = schemas::describe_field(&Column::float(name, "nT", "").field()).removed;
            Column::float(name, "nT", "").without(removed)
        };
        let target = Column::float("target", "nT", "").without([MagneticCorrection::Diurnal].into());
        TableShape { columns: names.map(column).into_iter().chain([target]).collect(), rate_hz: None }
    }

    #[test]
    fn unit_an_expression_has_its_own_corrections_and_those_of_its_terms() {
        let of = |sql: &str| {
            let expression = Expression::new(sql, &shape(), "`x`").unwrap();
            of_expression(&expression, &shape()).iter().map(|c| c.word()).collect::<Vec<_>>().join(",")
        };
        for (sql, expected) in [
            ("mag_4_uc", ""),
            ("mag_4_uc + 10.0", ""),
            ("mag_4_uc - diurnal", "diurnal"),
            ("mag_4_uc - (igrf + diurnal)", "core,diurnal"),
            ("-(diurnal - mag_4_uc)", "diurnal"),
            ("mag_4_uc - 1.0 * diurnal", "diurnal"),
            ("coalesce(target, mag_4_uc)", "diurnal"),
            ("target + diurnal", ""),
            ("mag_1_igrf + igrf", "diurnal,lag"),
            ("mag_4_uc - mag_5_uc", "core,diurnal"),
            ("case when cur_1 > 0 then target else NULL end", "diurnal"),
            ("igrf + diurnal", ""),
        ] {
            assert_eq!(of(sql), expected, "{sql}");
        }
    }

    #[test]
    fn unit_a_correction_is_made_once() {
        let (plain, had) = (["mag_4_uc".to_owned()], ["target".to_owned()]);
        let mixed = [plain.clone(), had.clone()].concat();
        let diurnal = |readings: &[String], given| {
            let makes = corrects(&shape(), readings, MagneticCorrection::Diurnal, given, true);
            let fault = twice(&shape(), readings, MagneticCorrection::Diurnal, given, REMOVE_DIURNAL);
            (makes, fault.is_some(), note(&shape(), readings, MagneticCorrection::Diurnal, given).is_some())
        };
        assert_eq!(diurnal(&plain, None), (true, false, false));
        assert_eq!(diurnal(&plain, Some(true)), (true, false, false));
        assert_eq!(diurnal(&had, None), (false, false, true));
        assert_eq!(diurnal(&had, Some(false)), (false, false, false));
        assert!(diurnal(&had, Some(true)).1, "asked for outright it is an error");
        assert!(diurnal(&mixed, None).1 && diurnal(&mixed, Some(true)).1);
        assert!(!diurnal(&mixed, Some(false)).1);
    }
}
