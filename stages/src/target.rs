//! Computes the target of a compensation model.

use schemas::{
    Column, CorrectionSet, Fault, LineInput, LineOutput, LineStage, MagneticCorrection, Role, Stage, StageSchema,
    Table, TableShape, choice, stage,
};

use crate::{
    columns::{array, floats, shape},
    corrections::{CorrectionKey, REMOVE_CORE, REMOVE_DIURNAL, corrects, had, note, twice},
    map_value::{MAP_ANOMALY as MAP, note_of_ins_position},
};

choice! {
    /// Type of target, as in Gnadt 2022, section 3.7.
    pub enum TargetType {
        /// Truth minus core field and diurnal variation.
        A = "a",
        /// Value of the map.
        B = "b",
        /// Magnetometer minus core field, diurnal variation and map.
        C = "c",
        /// Magnetometer minus truth.
        D = "d",
        /// Magnetometer minus core field and diurnal variation.
        E = "e",
    }
}

stage! {
    /// Appends `target`, one of the five targets of Gnadt 2022 to which models are fitted.
    ///
    /// | type | target | a model fitted to it predicts |
    /// |---|---|---|
    /// | `a` | truth minus core field and diurnal variation | the anomaly |
    /// | `b` | value of the map | the anomaly |
    /// | `c` | magnetometer minus core field, diurnal variation and map | the aircraft field |
    /// | `d` | magnetometer minus truth | the aircraft field |
    /// | `e` | magnetometer minus core field and diurnal variation; `fit` band-passes it | the aircraft field |
    ///
    /// Set `target` of `fit` to this column. For all types except `e`, also switch the filter of `fit` off with `low_hz
    /// = 0` and `high_hz = 0`. To apply a model of the anomaly, set `predicts = "anomaly"` in `compensate`. Types `b`
    /// and `c` require `map_anomaly`, which `map_value` computes.
    ///
    /// The column has the role truth: it may be a target but not a feature. The result is NaN for a sample with a
    /// missing term. The metadata entry `removed` lists the corrections, so that no later stage repeats them.
    ///
    /// Source: Gnadt 2022, section 3.7.
    Target = "target", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name  = "target"
stage = "target"
input = "features"
kind  = "d"
mag   = "mag_4_uc"
truth = "mag_1_c"
"#;
    /// Type of the target.
    kind: TargetType, unit "", default TargetType::D;
    /// Scalar magnetometer to be compensated, for `c`, `d` and `e`.
    mag: Option<String>, unit "nT", absent "the targets `c`, `d` and `e` are rejected";
    /// Column of the true field, for `a` and `d`.
    truth: String, unit "nT", default "mag_1_c";
    /// Subtracts the core field `igrf` from targets `a`, `c` and `e`.
    remove_core: Option<bool>, unit "", absent "true, unless the correction has already been applied";
    /// Subtracts the diurnal variation `diurnal` from targets `a`, `c` and `e`.
    remove_diurnal: Option<bool>, unit "", absent "true, unless the correction has already been applied";
}

impl Target {
    /// Corrections of the minuend of the target: each correction with its key and the column to subtract.
    fn corrections(&self) -> [(MagneticCorrection, Option<bool>, CorrectionKey, &'static str); 2] {
        [
            (MagneticCorrection::Core, self.remove_core, REMOVE_CORE, "igrf"),
            (MagneticCorrection::Diurnal, self.remove_diurnal, REMOVE_DIURNAL, "diurnal"),
        ]
    }

    /// Returns whether core field and diurnal variation are subtracted from the minuend.
    fn is_reduced(&self) -> bool {
        matches!(self.kind, TargetType::A | TargetType::C | TargetType::E)
    }

    /// Corrections applied to the target.
    fn removed(&self, shape: &TableShape, from: &str, less: &[String]) -> CorrectionSet {
        let both = [MagneticCorrection::Core, MagneticCorrection::Diurnal];
        match self.kind {
            TargetType::B => both.into(),
            TargetType::D => had(shape, from).into_iter().chain(both).collect(),
            TargetType::A | TargetType::C | TargetType::E => had(shape, from)
                .into_iter()
                .chain(less.iter().filter_map(|name| MagneticCorrection::by_column(name)))
                .collect(),
        }
    }

    /// Minuend of the target, and the columns to subtract from it.
    fn parts(&self, shape: &TableShape) -> Result<(String, Vec<String>), Fault> {
        let mag = || {
            let missing = || Fault::new(format!("type `{}` requires `mag`", self.kind.word())).of_param("kind");
            self.mag.clone().ok_or_else(missing)
        };
        let earth = |from: String| {
            let own = std::slice::from_ref(&from);
            let less = self.corrections().into_iter().filter(|(c, given, ..)| corrects(shape, own, *c, *given, true));
            let less: Vec<String> = less.map(|(.., column)| column.to_owned()).collect();
            (from, less)
        };
        match self.kind {
            TargetType::A => Ok(earth(self.truth.clone())),
            TargetType::B => Ok((MAP.to_owned(), vec![])),
            TargetType::C => {
                let (from, less) = earth(mag()?);
                Ok((from, less.into_iter().chain([MAP.to_owned()]).collect()))
            }
            TargetType::D => Ok((mag()?, vec![self.truth.clone()])),
            TargetType::E => Ok(earth(mag()?)),
        }
    }

    fn needs(&self, shape: &TableShape, name: &str) -> Result<(), Fault> {
        let found = shape.number(name, "nT").map(|_| ());
        found.map_err(|fault| match name {
            MAP => fault.help("add a `map_value` stage before this one").of_param("kind"),
            "igrf" => fault.help("add a `core_field` stage, or set `remove_core = false`").of_param("remove_core"),
            "diurnal" => {
                fault.help("add a `diurnal` stage, or set `remove_diurnal = false`").of_param("remove_diurnal")
            }
            _ if name == self.truth => fault.of_param("truth"),
            _ => fault.of_param("mag"),
        })
    }
}

impl Stage for Target {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let (from, less) = self.parts(shape).map_err(|f| vec![f])?;
        let removed = self.removed(shape, &from, &less);
        let own = [from.clone()];
        let reads: Vec<String> = std::iter::once(from).chain(less).collect();
        let mut faults: Vec<Fault> = reads.iter().filter_map(|name| self.needs(shape, name).err()).collect();
        if self.kind == TargetType::E && reads.first() == Some(&self.truth) {
            faults.push(
                Fault::new("`mag` is the truth, which requires no compensation; name another magnetometer")
                    .of_param("mag"),
            );
        }
        let corrections = || self.corrections().into_iter().filter(|_| self.is_reduced());
        faults.extend(corrections().filter_map(|(c, given, key, _)| twice(shape, &own, c, given, key)));
        if self.kind == TargetType::D {
            let part = |name: &str| -> CorrectionSet {
                had(shape, name).into_iter().filter(|c| *c != MagneticCorrection::Lag).collect()
            };
            if part(&own[0]) != part(&self.truth) {
                let what = format!(
                    "`{}` and `{}` have had different corrections, so their difference is not an aircraft field",
                    own[0], self.truth
                );
                let help = "set `mag` and `truth` to columns that both include core field and diurnal variation, or \
                    both exclude them";
                faults.push(Fault::new(what).help(help).of_param("truth"));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let doc = format!("target of a model: type {} of Gnadt 2022, section 3.7", self.kind.word());
        let column = Column::float("target", "nT", doc).role(Role::Truth).from(0, &reads).without(removed);
        let mut yields = StageSchema::append(vec![column], &reads);
        yields.notes.extend(note_of_ins_position(shape).filter(|_| reads.iter().any(|name| name == MAP)));
        yields.notes.extend(corrections().filter_map(|(c, given, ..)| note(shape, &own, c, given)));
        Ok(yields)
    }
}

impl LineStage for Target {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let (from, less) = self.parts(&TableShape::from_schema(&batch.schema()))?;
        let mut target = floats(batch, &from)?.to_vec();
        for name in less {
            target.iter_mut().zip(floats(batch, &name)?).for_each(|(t, x)| *t -= x);
        }
        Ok(vec![array(target)])
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::Arc;

    use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};

    use schemas::ParamValue;

    use super::*;

    fn target(kind: &str) -> Target {
        Target {
            kind: TargetType::read(&schemas::Literal::Text(kind.to_owned())).unwrap(),
            mag: Some("mag_4_uc".into()),
            truth: "mag_1_c".into(),
            remove_core: None,
            remove_diurnal: None,
        }
    }

    fn line() -> LineInput {
        let column = |x: f64| Arc::new(arrow_array::Float64Array::from(vec![x, f64::NAN])) as arrow_array::ArrayRef;
        let columns =
            [("mag_4_uc", 50_300.0), ("mag_1_c", 50_110.0), ("igrf", 50_000.0), ("diurnal", 10.0), (MAP, 99.0)];
        let batch = RecordBatch::try_from_iter(columns.map(|(n, x)| (n, column(x)))).unwrap();
        LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
    }

    #[test]
    fn ref_the_five_target_types_agree_with_the_thesis() {
        for (kind, expected) in [("a", 100.0), ("b", 99.0), ("c", 191.0), ("d", 190.0), ("e", 290.0)] {
            let made = target(kind).run(&line(), &()).unwrap();
            let values = made[0].as_primitive::<Float64Type>().values();
            assert_eq!(values[0], expected, "{kind}");
            assert!(values[1].is_nan());
        }
        let kept =
            Target { remove_core: Some(false), remove_diurnal: Some(false), ..target("e") }.run(&line(), &()).unwrap();
        assert_eq!(kept[0].as_primitive::<Float64Type>().value(0), 50_300.0);
    }

    #[test]
    fn unit_missing_columns_are_reported_with_the_remedy() {
        let columns = ["mag_4_uc", "mag_1_c", "igrf"].map(|n| Column::float(n, "nT", ""));
        let table = Table::Lines(TableShape { columns: columns.to_vec().into(), rate_hz: None });
        let fault_texts =
            |t: &Target| t.yields(&[&table]).unwrap_err().iter().map(ToString::to_string).collect::<String>();
        assert!(fault_texts(&target("c")).contains("map_value"));
        assert!(fault_texts(&target("e")).contains("remove_diurnal"));
        assert!(fault_texts(&Target { mag: None, ..target("d") }).contains("requires `mag`"));
        let made = target("d").yields(&[&table]).unwrap();
        assert_eq!(made.columns[0].role, Role::Truth);
    }

    #[test]
    fn unit_a_map_at_the_ins_position_is_noted() {
        let notes = |role: Role| {
            let place = [("lat", "deg"), ("lon", "deg"), ("alt", "m")];
            let mut columns: Vec<Column> =
                place.map(|(name, unit)| Column::float(name, unit, "").role(Role::Truth)).to_vec();
            columns.push(Column::float("map_anomaly", "nT", "").role(role));
            target("b").yields(&[&Table::Lines(TableShape { columns: columns.into(), rate_hz: None })]).unwrap().notes
        };
        assert!(notes(Role::Truth).is_empty());
        assert!(notes(Role::Derived)[0].contains("`position = \"truth\"`"), "{:?}", notes(Role::Derived));
    }
}
