//! Subtracts the aircraft field from a scalar magnetometer.

use arrow_array::RecordBatch;
use numerics::regression::statistics;
use schemas::{
    Column, CorrectionSet, Fault, LineInput, LineOutput, LineStage, Stage, StageSchema, Table, choice, stage,
};

use crate::{
    columns::{array, faults_of, floats, no_truth, shape},
    corrections::had,
    fitted::FittedModel,
    model_columns::{RATE, RESIDUAL},
    trained::{FieldPrediction, PART_VECTORS},
};

choice! {
    /// Quantity that a model predicts.
    pub enum PredictedQuantity {
        /// Aircraft field.
        Aircraft = "aircraft",
        /// Anomaly, without core field and diurnal variation.
        Anomaly = "anomaly",
        /// Total field.
        Field = "field",
    }
}

stage! {
    /// Subtracts from a scalar magnetometer the aircraft field that a fitted model predicts.
    ///
    /// Appends the compensated field `mag_c` and the predicted aircraft field `mag_aircraft`. Their sum is the reading
    /// of the magnetometer. Both are NaN if the sample lacks a term of the model.
    ///
    /// Terms that are differences per sample are converted to the sample rate of the fit, so a line with another sample
    /// rate is accepted. A central difference underestimates the rate of change at frequency f by the fraction (2 pi f
    /// / rate)^2 / 6. For f = 0.2 Hz, this fraction is 0.3 % at a rate of 10 Hz and 1 % at 5 Hz. A model without a
    /// stored rate, or with a lagged feature, is rejected if the rates may differ.
    ///
    /// The metadata of `mag_c` list the corrections already applied to `mag`, such as the removal of the diurnal
    /// variation.
    ///
    /// A model fitted to band-passed data does not determine the constant part of the aircraft field. With `detrend`,
    /// as in MagNav.jl's examples, the prediction is subtracted without its mean over the line. A nonlinear model
    /// predicts the constant part if its target includes that part.
    ///
    /// `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau` describe the noise of `mag_c`, estimated from the residual of
    /// the model on its calibration lines. Their values are the same for all samples. `navigate` uses them for noise
    /// parameters that are set to `"auto"`.
    ///
    /// `mag_aircraft_sigma` is the standard deviation of the prediction. Ensembles of networks and `random_features`
    /// provide it; for other models it is null.
    ///
    /// `parts` appends the parts of the prediction in nT, before `detrend` and before `igrf` and `diurnal` are added.
    /// `part_linear` is the prediction of the linear terms alone. It is the whole prediction of a linear model, and 0
    /// for `m1`, `m2a`, trees and random features. `part_network` is the remaining prediction, from the network and
    /// constants. For the models `m3tl` to `m3tf`, `part_permanent_x` to `part_eddy_z` are the permanent, induced and
    /// eddy-current vectors along the axes of the vector magnetometer. `part_network_x` to `part_network_z` are the
    /// components of the vector that the network predicts. They are 0 except for `m3v` and `m3vc`. For other models,
    /// all vectors are null.
    ///
    /// Source: Gnadt 2022, (3.22).
    Compensate = "compensate", version 4, grain Line, role Compensates, inputs [input: Lines, model: Model],
    example r#"
[[stages]]
name  = "compensate"
stage = "compensate"
input = "a_matrix"
model = "fit"
mag   = "mag_4_uc"
"#;
    /// Scalar magnetometer, such as `mag_4_uc`.
    mag: String, unit "nT";
    /// Quantity that the model was fitted to predict. `aircraft` is the aircraft field. `anomaly` is the anomaly, to
    /// which `igrf` and `diurnal` are added (targets `a` and `b`). `field` is the total field.
    predicts: PredictedQuantity, unit "", default PredictedQuantity::Aircraft;
    /// Terms of the model that are not part of the aircraft field and are not subtracted, such as `easting` and
    /// `northing`.
    without: Vec<String>, unit "", default Vec::<String>::new();
    /// Subtracts the predicted aircraft field without its mean over the line.
    detrend: bool, unit "", default false;
    /// Appends the parts of the prediction.
    parts: bool, unit "", default false;
    /// Allows truth columns as inputs.
    allow_truth: bool, unit "", default false;
}

impl Stage for Compensate {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let lines = shape(inputs, 0)?;
        let Some(Table::Model { features, shape }) = inputs.get(1) else {
            return Err(vec![Fault::new("`model` is not a model table")]);
        };
        if shape.get("term").is_none() {
            return Err(vec![
                Fault::new("`model` has no column `term`").help("name the table of a stage `fit`").of_param("model"),
            ]);
        }
        let mut faults = vec![];
        if let Err(fault) = lines.number(&self.mag, "nT").and_then(|c| no_truth(c, "mag", self.allow_truth)) {
            faults.push(fault.of_param("mag"));
        }
        for feature in features {
            if let Err(fault) = lines.need(feature) {
                faults.push(
                    Fault { what: format!("the model was fitted with `{feature}`, but {}", fault.what), ..fault }
                        .of_param("input"),
                );
            }
        }
        if self.predicts == PredictedQuantity::Anomaly {
            faults.extend(faults_of(EARTH.iter().map(|name| lines.number(name, "nT")), "predicts"));
        }
        if self.predicts != PredictedQuantity::Aircraft && self.detrend {
            faults.push(Fault::new("`detrend` requires `predicts = \"aircraft\"`").of_param("detrend"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec![self.mag.clone()];
        reads.extend(
            EARTH.iter().filter(|_| self.predicts == PredictedQuantity::Anomaly).map(|name| (*name).to_owned()),
        );
        reads.extend(features.iter().cloned());
        let rate = shape.get(RATE).map(|_| RATE);
        let of_model: Vec<&str> = ["term", "value"].into_iter().chain(rate).collect();
        let made = |name, doc| Column::float(name, "nT", doc).from(0, &reads).from(1, &of_model);
        // If the model predicts the anomaly or the total field, `mag_c` is a total field to which no correction was
        // applied.
        let removed =
            if self.predicts == PredictedQuantity::Aircraft { had(lines, &self.mag) } else { CorrectionSet::new() };
        let mut columns = vec![
            made("mag_c", "compensated field").without(removed),
            made("mag_aircraft", "predicted aircraft field, which was subtracted"),
        ];
        columns.extend(noise_columns(&RESIDUAL));
        columns.push(made(
            "mag_aircraft_sigma",
            "standard deviation of the prediction; null if the model does not provide one",
        ));
        if self.parts {
            let vectors = PART_VECTORS.map(|name| {
                (format!("part_{name}"), "component of a vector of the model 3 family; null for other models")
            });
            let scalars = [
                ("part_linear".to_owned(), "prediction of the linear terms"),
                ("part_network".to_owned(), "prediction minus the prediction of the linear terms"),
            ];
            let made = |(name, doc): (String, &str)| Column::float(name, "nT", doc).from(0, &reads).from(1, &of_model);
            columns.extend(scalars.into_iter().chain(vectors).map(made));
        }
        // A model of a window of samples depends on the order of the samples.
        reads.push("tt".to_owned());
        let mut yields = StageSchema::append(columns, &reads);
        yields.reads.push(of_model.into_iter().chain(RESIDUAL).map(str::to_owned).collect());
        Ok(yields)
    }
}

impl LineStage for Compensate {
    type Prepared = CompensationModel;

    fn run(&self, line: &LineInput, model: &CompensationModel) -> LineOutput {
        let mag = floats(&line.inputs[0], &self.mag)?;
        let noise = model.noise.map(|x| array(vec![x; mag.len()]));
        let FieldPrediction { field_nt: mut aircraft, sigma_nt } = model.fitted.predict(&line.inputs[0], mag.len())?;
        let mut noise: Vec<_> = noise.into_iter().collect();
        noise.push(array(sigma_nt.unwrap_or_else(|| vec![f64::NAN; mag.len()])));
        if self.parts {
            noise.extend(self.parts_of(line, model, &aircraft)?);
        }
        if self.predicts != PredictedQuantity::Aircraft {
            let mut field = aircraft;
            for name in EARTH.iter().filter(|_| self.predicts == PredictedQuantity::Anomaly) {
                field.iter_mut().zip(floats(&line.inputs[0], name)?).for_each(|(f, x)| *f += x);
            }
            let off = mag.iter().zip(&field).map(|(m, f)| m - f).collect();
            return Ok([array(field), array(off)].into_iter().chain(noise).collect());
        }
        if self.detrend {
            let mean = statistics::mean(&aircraft).value;
            aircraft.iter_mut().for_each(|x| *x -= mean);
        }
        let clean: Vec<f64> = mag.iter().zip(&aircraft).map(|(m, a)| m - a).collect();
        Ok([array(clean), array(aircraft)].into_iter().chain(noise).collect())
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<CompensationModel, Fault> {
        let table = inputs.get(1).ok_or_else(|| Fault::data("the model is missing"))?;
        let fitted = FittedModel::read(table, &self.without)?;
        let mut noise = [f64::NAN; 3];
        for (to, name) in noise.iter_mut().zip(RESIDUAL) {
            *to = floats(table, name)?.first().copied().unwrap_or(f64::NAN);
        }
        Ok(CompensationModel { fitted, noise })
    }

    fn prepare_key(&self) -> String {
        self.without.join(",")
    }
}

impl Compensate {
    /// Columns with the parts of the predicted field.
    fn parts_of(&self, line: &LineInput, model: &CompensationModel, field_nt: &[f64]) -> LineOutput {
        let rows = field_nt.len();
        let parts = model.fitted.parts(&line.inputs[0], field_nt)?;
        let network = field_nt.iter().zip(&parts.linear_nt).map(|(field, linear)| field - linear).collect();
        let component = |k: usize| match parts.vectors_nt.is_empty() {
            true => vec![f64::NAN; rows],
            false => parts.vectors_nt.iter().map(|row| row[k]).collect(),
        };
        let vectors: Vec<_> = (0..PART_VECTORS.len()).map(|k| array(component(k))).collect();
        Ok([array(parts.linear_nt), array(network)].into_iter().chain(vectors).collect())
    }
}

/// Columns that are added to an anomaly to get the total field.
const EARTH: [&str; 2] = ["igrf", "diurnal"];

/// Columns that hold the noise of a compensated signal, with their units.
pub(crate) const NOISE: [(&str, &str); 3] = [("mag_sigma", "nT"), ("mag_fogm_sigma", "nT"), ("mag_fogm_tau", "s")];

/// Columns of the model from which the columns of [`NOISE`] are computed.
pub(crate) fn noise_columns(model: &[&str]) -> Vec<Column> {
    let docs = [
        "standard deviation of the white noise of one sample",
        "standard deviation of the first-order Gauss-Markov noise",
        "time constant of the first-order Gauss-Markov noise",
    ];
    NOISE.iter().zip(docs).map(|((name, unit), doc)| Column::float(*name, *unit, doc).from(1, model)).collect()
}

pub struct CompensationModel {
    fitted: FittedModel,
    /// The values of [`NOISE`].
    noise: [f64; 3],
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{ArrayRef, StringArray, cast::AsArray, types::Float64Type};
    use arrow_schema::{Field, Schema};
    use schemas::{Role, TableShape};

    use super::*;
    use crate::columns::list;

    fn compensate() -> Compensate {
        Compensate {
            mag: "mag_4_uc".into(),
            predicts: PredictedQuantity::Aircraft,
            without: vec![],
            detrend: false,
            parts: false,
            allow_truth: false,
        }
    }

    fn columns() -> Vec<Column> {
        let tl = Column::list("tl", "", "", ["x", "y"].map(str::to_owned).to_vec());
        let plain = ["mag_4_uc", "igrf", "diurnal"].map(|name| Column::float(name, "nT", ""));
        [tl, Column::float("cur_1", "A", "")].into_iter().chain(plain).collect()
    }

    /// Three samples; in the last one, a term is missing.
    fn line() -> LineInput {
        let arrays = vec![
            list(vec![1.0, 10.0, 2.0, 20.0, 3.0, f64::NAN], 2).unwrap(),
            array(vec![5.0, 6.0, 7.0]),
            array(vec![50_100.0, 50_200.0, 50_300.0]),
            array(vec![50_000.0; 3]),
            array(vec![10.0; 3]),
        ];
        let fields: Vec<Field> = columns().iter().map(Column::field).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap();
        LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
    }

    /// The model 3 y - 2 cur_1 + 40, and the residual noise of its fit.
    fn model() -> RecordBatch {
        let terms: ArrayRef = Arc::new(StringArray::from(vec!["y", "cur_1", "intercept"]));
        let numbers = [("residual_sigma", 0.5), ("residual_fogm_sigma", 3.0), ("residual_fogm_tau", 120.0)];
        let numbers = numbers.map(|(name, value)| (name, array(vec![value; 3])));
        let columns = [("term", terms), ("value", array(vec![3.0, -2.0, 40.0]))].into_iter().chain(numbers);
        RecordBatch::try_from_iter(columns).unwrap()
    }

    fn made(stage: &Compensate) -> Vec<Vec<f64>> {
        let model = stage.prepare(&[line().inputs[0].slice(0, 0), model()]).unwrap();
        let arrays = stage.run(&line(), &model).unwrap();
        arrays.iter().map(|a| a.as_primitive::<Float64Type>().values().to_vec()).collect()
    }

    /// The first two samples of `mag_c` and `mag_aircraft`; the third must be NaN in both.
    fn fields(stage: &Compensate) -> [[f64; 2]; 2] {
        let made = made(stage);
        assert!(made[0][2].is_nan() && made[1][2].is_nan());
        [[made[0][0], made[0][1]], [made[1][0], made[1][1]]]
    }

    #[test]
    fn law_the_subtracted_field_is_the_sum_of_coefficients_times_terms() {
        // 3 10 - 2 5 + 40 = 60 and 3 20 - 2 6 + 40 = 88.
        assert_eq!(fields(&compensate()), [[50_040.0, 50_112.0], [60.0, 88.0]]);
        let without =
            |names: &[&str]| Compensate { without: names.iter().map(ToString::to_string).collect(), ..compensate() };
        assert_eq!(fields(&without(&["cur_1"]))[1], [70.0, 100.0]);
        assert_eq!(fields(&without(&["cur_1", "intercept"]))[1], [30.0, 60.0]);
        // The mean of 60 and 88 stays in the signal.
        assert_eq!(fields(&Compensate { detrend: true, ..compensate() }), [[50_114.0, 50_186.0], [-14.0, 14.0]]);
    }

    #[test]
    fn law_the_anomaly_plus_core_field_and_diurnal_is_the_field() {
        let of = |predicts: PredictedQuantity| fields(&Compensate { predicts, ..compensate() });
        assert_eq!(of(PredictedQuantity::Anomaly), [[50_070.0, 50_098.0], [30.0, 102.0]]);
        assert_eq!(of(PredictedQuantity::Field), [[60.0, 88.0], [50_040.0, 50_112.0]]);
    }

    #[test]
    fn law_the_parts_of_a_linear_model_are_its_prediction_and_nothing() {
        for detrend in [false, true] {
            let made = made(&Compensate { parts: true, detrend, ..compensate() });
            assert_eq!(made.len(), 20);
            assert_eq!(made[6][..2], [60.0, 88.0]);
            assert_eq!(made[7][..2], [0.0, 0.0]);
            assert!(made[6][2].is_nan() && made[7][2].is_nan() && made[8..].iter().flatten().all(|x| x.is_nan()));
        }
    }

    #[test]
    fn unit_every_sample_has_the_noise_of_the_model() {
        for predicts in [PredictedQuantity::Aircraft, PredictedQuantity::Field] {
            let made = made(&Compensate { predicts, ..compensate() });
            assert_eq!(made[2..5], [vec![0.5; 3], vec![3.0; 3], vec![120.0; 3]]);
        }
    }

    #[test]
    fn unit_lines_without_the_model_terms_are_rejected_with_the_parameter() {
        let lacking = Compensate { without: vec!["easting".into()], ..compensate() };
        let fault = lacking.prepare(&[line().inputs[0].clone(), model()]).err().unwrap();
        assert_eq!(fault.what, "the model has no term `easting`, which `without` names");
        assert_eq!(fault.param.as_deref(), Some("without"));

        let features = ["tl", "cur_1"].map(str::to_owned).to_vec();
        let shape = |columns: Vec<Column>| TableShape { columns: columns.into(), rate_hz: None };
        let fitted =
            Table::Model { shape: shape(vec![Column::text("term", ""), Column::float("value", "", "")]), features };
        let yields = |stage: &Compensate, columns: Vec<Column>, model: &Table| {
            stage.yields(&[&Table::Lines(shape(columns)), model])
        };
        let fault_texts = |stage: &Compensate, columns: Vec<Column>, model: &Table| {
            let faults = yields(stage, columns, model).unwrap_err();
            faults.iter().map(|f| format!("{} [{}]", f.what, f.param.clone().unwrap_or_default())).collect::<Vec<_>>()
        };
        let only = |names: &[&str]| columns().into_iter().filter(|c| names.contains(&c.name.as_str())).collect();
        let made = yields(&compensate(), columns(), &fitted).unwrap().columns;
        let names: Vec<&str> = made.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(
            names,
            ["mag_c", "mag_aircraft", "mag_sigma", "mag_fogm_sigma", "mag_fogm_tau", "mag_aircraft_sigma"]
        );
        let expected = "the model was fitted with `cur_1`, but there is no column `cur_1` [input]";
        assert_eq!(fault_texts(&compensate(), only(&["tl", "mag_4_uc"]), &fitted), [expected]);
        let anomaly = Compensate { predicts: PredictedQuantity::Anomaly, detrend: true, ..compensate() };
        let expected = [
            "there is no column `igrf` [predicts]",
            "there is no column `diurnal` [predicts]",
            "`detrend` requires `predicts = \"aircraft\"` [detrend]",
        ];
        assert_eq!(fault_texts(&anomaly, only(&["tl", "cur_1", "mag_4_uc"]), &fitted), expected);
        let truth = columns().into_iter().map(|c| if c.name == "mag_4_uc" { c.role(Role::Truth) } else { c });
        assert!(fault_texts(&compensate(), truth.collect(), &fitted)[0].ends_with("[mag]"));
        let noise = Table::Model { shape: shape(vec![Column::float("residual_sigma", "nT", "")]), features: vec![] };
        assert_eq!(fault_texts(&compensate(), columns(), &noise), ["`model` has no column `term` [model]"]);
    }
}
