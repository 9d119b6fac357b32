//! Noise of a compensated signal over a known field, and its assignment to lines.

use arrow_array::{ArrayRef, Int64Array, RecordBatch};
use numerics::signal::{
    noise::{BlockMeans, noise},
    segments::RowMask,
};
use schemas::{
    CheckpointMonitor, Column, Fault, LineInput, LineOutput, LineStage, MagneticCorrection, PassThroughColumns, Stage,
    StageOutput, StageSchema, SurveyAggregator, SurveyPoint, SurveyStage, Table, TableShape, stage,
};

use crate::{
    columns::{array, data, even_rate_hz, floats, shape},
    compensate::noise_columns,
    corrections::had,
    map_value::{MAP_ANOMALY, note_of_ins_position},
    model_columns::RESIDUAL,
};

stage! {
    /// Estimates the noise of a compensated signal on the lines that `where` selects. The true field comes from another
    /// magnetometer (`truth`) or, if that is unset, from a map, the core field and the diurnal variation.
    ///
    /// `fit` estimates the noise from the residual on its calibration lines. This noise therefore includes the anomaly
    /// and the effect of manoeuvres. `residual_noise` is more realistic: it uses lines flown over a map as in
    /// navigation, and includes the error of the map. `assume_noise` assigns the result to other lines, and `navigate`
    /// uses it for noise parameters that are `"auto"`. Do not select the lines that are navigated: their scores would
    /// be in sample.
    ///
    /// The noise has a white part and a first-order Gauss-Markov part. They are the smallest parts whose combined Allan
    /// variance is nowhere below the Allan variance of the lines. A constant error has no effect. A time constant
    /// longer than the lines cannot be resolved. Lines without 16 s of uninterrupted data are rejected.
    ///
    /// Source: Allan 1966; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8.
    ResidualNoise = "residual_noise", version 2, grain Survey, inputs [input: Lines],
    example r#"
[[stages]]
name  = "residual_noise"
stage = "residual_noise"
input = "compensate"
truth = "mag_1_c"
"#;
    /// Compensated signal.
    mag: String, unit "nT", default "mag_c";
    /// Column of the true field, such as `mag_1_c`.
    truth: Option<String>, unit "nT", absent "the sum of `igrf`, `map_anomaly` (computed by `map_value`) and, if \
        present, `diurnal`, without the fields already removed from `mag`";
}

stage! {
    /// Appends the noise parameters that `residual_noise`, `fogm_noise` or `fit` estimated: `mag_sigma`,
    /// `mag_fogm_sigma` and `mag_fogm_tau`, each with the same value at all samples. They replace the columns of the
    /// same names from `compensate`.
    AssumeNoise = "assume_noise", version 1, grain Line, inputs [input: Lines, noise: Model],
    example r#"
[[stages]]
name  = "assume_noise"
stage = "assume_noise"
input = "compensate"
noise = "residual_noise"
"#;
}

const DIURNAL: &str = "diurnal";

impl ResidualNoise {
    /// Columns that are subtracted from the signal.
    fn less(&self, shape: &TableShape) -> Vec<String> {
        let Some(truth) = &self.truth else {
            let removed = had(shape, &self.mag);
            let left = |name: &&str| MagneticCorrection::by_column(name).is_none_or(|c| !removed.contains(&c));
            let diurnal = shape.get(DIURNAL).map(|_| DIURNAL);
            let all = ["igrf", MAP_ANOMALY].into_iter().chain(diurnal).filter(left);
            return all.map(str::to_owned).collect();
        };
        vec![truth.clone()]
    }

    fn needs(&self, shape: &TableShape, name: &str) -> Result<(), Fault> {
        let found = shape.number(name, "nT").map(|_| ());
        found.map_err(|fault| match name {
            "igrf" => {
                fault.help("add a `core_field` stage, or set `truth` to the column of the true field").of_param("input")
            }
            MAP_ANOMALY => {
                fault.help("add a `map_value` stage, or set `truth` to the column of the true field").of_param("input")
            }
            _ if name == self.mag => fault.of_param("mag"),
            _ => fault.of_param("truth"),
        })
    }

    fn blocks(&self, batch: &RecordBatch, line: &LineInput) -> Result<BlockMeans, Fault> {
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        let mut left = floats(batch, &self.mag)?.to_vec();
        for name in self.less(&TableShape::from_schema(&batch.schema())) {
            left.iter_mut().zip(floats(batch, &name)?).for_each(|(l, x)| *l -= x);
        }
        let selected = line.keep.as_ref().map_or_else(|| RowMask::all(tt.len()), |keep| RowMask::selected(keep));
        Ok(BlockMeans::from_runs(&left, &selected.and_finite(&left).runs_in_time(tt, rate_hz), rate_hz))
    }
}

impl Stage for ResidualNoise {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut reads = vec![self.mag.clone()];
        reads.extend(self.less(shape));
        let faults: Vec<Fault> = reads.iter().filter_map(|name| self.needs(shape, name).err()).collect();
        if !faults.is_empty() {
            return Err(faults);
        }
        reads.push("tt".to_owned());
        let columns = vec![
            Column::float(RESIDUAL[0], "nT", "standard deviation of the white noise of one sample"),
            Column::float(RESIDUAL[1], "nT", "standard deviation of the Gauss-Markov noise"),
            Column::float(RESIDUAL[2], "s", "time constant of the Gauss-Markov noise"),
            Column::integer("n", "", "number of samples used"),
        ];
        let columns = columns.into_iter().map(|c| c.from(0, &reads)).collect();
        let mut yields = StageSchema { passes: PassThroughColumns::None, ..StageSchema::append(columns, &reads) };
        yields.notes.extend(note_of_ins_position(shape).filter(|_| reads.iter().any(|name| name == MAP_ANOMALY)));
        Ok(yields)
    }
}

impl SurveyStage for ResidualNoise {
    type Gather = ResidualNoiseAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> ResidualNoiseAggregator {
        ResidualNoiseAggregator { points: points.into_iter().map(|point| point.stage.clone()).collect() }
    }
}

/// Points of a sweep over lines with a known field.
pub struct ResidualNoiseAggregator {
    points: Vec<ResidualNoise>,
}

/// Residual of one line at each point of a sweep.
pub struct LineResidualBlocks {
    blocks: Vec<Result<BlockMeans, Fault>>,
}

impl SurveyAggregator for ResidualNoiseAggregator {
    type Part = LineResidualBlocks;

    fn map(&self, line: &LineInput) -> Result<LineResidualBlocks, Fault> {
        let blocks = self.points.iter().map(|p| p.blocks(&line.inputs[0], line));
        Ok(LineResidualBlocks { blocks: blocks.map(|b| b.map_err(|f| f.in_line(&line.flight, &line.line))).collect() })
    }

    fn finish(&self, parts: Vec<LineResidualBlocks>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        (0..self.points.len())
            .map(|i| {
                let lines: Vec<BlockMeans> = parts.iter().map(|p| p.blocks[i].clone()).collect::<Result<_, _>>()?;
                let found = noise(&lines).map_err(|e| data(e).help("select longer lines with `where`"))?;
                let block = |l: &BlockMeans| (l.block_s / l.step_s).round() as i64;
                let n: i64 = lines.iter().map(|l| block(l) * l.runs.iter().map(Vec::len).sum::<usize>() as i64).sum();
                let one = |x: f64| array(vec![x]);
                let n: ArrayRef = std::sync::Arc::new(Int64Array::from(vec![n]));
                Ok(vec![one(found.white_nt), one(found.lasting.sigma), one(found.lasting.tau_s), n].into())
            })
            .collect()
    }
}

impl Stage for AssumeNoise {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let noise = shape(inputs, 1)?;
        if RESIDUAL.iter().any(|name| noise.get(name).is_none()) {
            let what = "`noise` has no noise columns";
            return Err(vec![
                Fault::new(what)
                    .help("name the table of a stage `residual_noise`, `fogm_noise` or `fit`")
                    .of_param("noise"),
            ]);
        }
        let mut yields = StageSchema::append(noise_columns(&RESIDUAL), &["tt"]);
        yields.reads.push(RESIDUAL.map(str::to_owned).to_vec());
        Ok(yields)
    }
}

impl LineStage for AssumeNoise {
    type Prepared = [f64; 3];

    fn run(&self, line: &LineInput, noise: &[f64; 3]) -> LineOutput {
        let rows = floats(&line.inputs[0], "tt")?.len();
        Ok(noise.iter().map(|x| array(vec![*x; rows])).collect())
    }

    fn prepare(&self, inputs: &[RecordBatch]) -> Result<[f64; 3], Fault> {
        let table = inputs.get(1).ok_or_else(|| Fault::data("the noise is missing"))?;
        let mut noise = [f64::NAN; 3];
        for (to, name) in noise.iter_mut().zip(RESIDUAL) {
            *to = floats(table, name)?.first().copied().unwrap_or(f64::NAN);
        }
        Ok(noise)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;

    use arrow_array::{
        Float64Array,
        cast::AsArray,
        types::{Float64Type, Int64Type},
    };
    use numerics::random::NormalGenerator;

    use super::*;

    const ROWS: usize = 4000;
    const SIGMA_NT: f64 = 2.0;

    /// A line at 10 Hz.
    fn line(columns: Vec<(&str, Vec<f64>)>) -> LineInput {
        let tt = (0..columns[0].1.len()).map(|k| 0.1 * k as f64).collect();
        let columns = [("tt", tt)].into_iter().chain(columns);
        let arrays = columns.map(|(name, values)| (name, Arc::new(Float64Array::from(values)) as ArrayRef));
        let batch = RecordBatch::try_from_iter(arrays).unwrap();
        LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
    }

    fn white(seed: u64, rows: usize) -> Vec<f64> {
        let mut normals = NormalGenerator::new(seed);
        (0..rows).map(|_| SIGMA_NT * normals.draw()).collect()
    }

    /// A field of 50,000 nT with a slow variation.
    fn slow(rows: usize, amplitude_nt: f64) -> Vec<f64> {
        (0..rows).map(|k| 50_000.0 + amplitude_nt * (0.01 * k as f64).sin()).collect()
    }

    fn sum(parts: &[&[f64]]) -> Vec<f64> {
        (0..parts[0].len()).map(|k| parts.iter().map(|part| part[k]).sum()).collect()
    }

    fn stage(truth: Option<&str>) -> ResidualNoise {
        ResidualNoise { mag: "mag_c".into(), truth: truth.map(str::to_owned) }
    }

    /// Estimated white noise, and the number of samples.
    fn found(stage: &ResidualNoise, lines: &[LineInput]) -> Result<(f64, i64), Fault> {
        let gather = ResidualNoise::gather(vec![crate::testing::point(stage)]);
        let parts = lines.iter().map(|line| gather.map(line).unwrap()).collect();
        let columns = gather.finish(parts, &schemas::NullMonitor).remove(0)?.columns;
        Ok((columns[0].as_primitive::<Float64Type>().value(0), columns[3].as_primitive::<Int64Type>().value(0)))
    }

    #[test]
    fn law_white_noise_is_found_for_any_field_and_constants() {
        let mut sigmas: Vec<f64> = vec![];
        for seed in 1..=9 {
            let (noise, truth) = (white(seed, ROWS), slow(ROWS, 300.0));
            let of = |offset_nt: f64| {
                let mag = sum(&[&noise, &truth, &[offset_nt; ROWS]]);
                found(&stage(Some("mag_1_c")), &[line(vec![("mag_c", mag), ("mag_1_c", truth.clone())])]).unwrap()
            };
            let (sigma, n) = of(0.0);
            assert_eq!(n, ROWS as i64);
            // Rounding error at 50,000 nT.
            assert!((of(-750.0).0 / sigma - 1.0).abs() < 1e-6);
            sigmas.push(sigma);
        }
        sigmas.sort_by(f64::total_cmp);
        // The estimate bounds the Allan variance at all averaging times. The error of the estimate is a few per cent
        // for a single line.
        assert!((sigmas[4] / SIGMA_NT - 1.0).abs() < 0.05, "{sigmas:?}");
        assert!(sigmas.iter().all(|s| (s / SIGMA_NT - 1.0).abs() < 0.15), "{sigmas:?}");
    }

    #[test]
    fn law_the_known_field_is_core_field_plus_map_plus_diurnal() {
        let (noise, igrf, map, diurnal) = (white(1, ROWS), slow(ROWS, 40.0), slow(ROWS, 150.0), slow(ROWS, 10.0));
        let field = sum(&[&igrf, &map, &diurnal]);
        let mag = || sum(&[&noise, &field]);
        let parts = vec![("mag_c", mag()), ("igrf", igrf), ("map_anomaly", map), ("diurnal", diurnal)];
        let of_truth =
            found(&stage(Some("mag_1_c")), &[line(vec![("mag_c", mag()), ("mag_1_c", field.clone())])]).unwrap();
        let of_parts = found(&stage(None), &[line(parts)]).unwrap();
        assert!((of_parts.0 / of_truth.0 - 1.0).abs() < 1e-6, "{of_parts:?} {of_truth:?}");
    }

    #[test]
    fn unit_only_selected_samples_count_and_a_short_line_is_rejected() {
        let (truth, mut mag) = (vec![0.0; ROWS], white(3, ROWS));
        let half = line(vec![("mag_c", mag[..ROWS / 2].to_vec()), ("mag_1_c", vec![0.0; ROWS / 2])]);
        mag[3 * ROWS / 4] = 1e6;
        let spiked = line(vec![("mag_c", mag), ("mag_1_c", truth)]);
        let keep = Some((0..ROWS).map(|k| k < ROWS / 2).collect());
        let of = |line: LineInput| found(&stage(Some("mag_1_c")), &[line]);
        assert_eq!(of(LineInput { keep, ..spiked }).unwrap(), of(half).unwrap());
        // 150 samples last 15 s.
        let fault = of(line(vec![("mag_c", white(1, 150)), ("mag_1_c", vec![0.0; 150])])).unwrap_err();
        assert!(fault.what.contains("at least 16 s"), "{fault}");
        assert!(fault.help.unwrap().contains("longer lines"));
    }

    #[test]
    fn unit_a_known_noise_applies_to_every_sample() {
        let figures = [0.7, 2.5, 90.0];
        let table = RESIDUAL.iter().zip(figures).map(|(name, value)| (*name, array(vec![value])));
        let table = RecordBatch::try_from_iter(table).unwrap();
        let line = line(vec![("mag_c", vec![0.0; 3])]);
        let noise = AssumeNoise {}.prepare(&[line.inputs[0].slice(0, 0), table]).unwrap();
        let made = AssumeNoise {}.run(&line, &noise).unwrap();
        let made: Vec<Vec<f64>> = made.iter().map(|a| a.as_primitive::<Float64Type>().values().to_vec()).collect();
        assert_eq!(made, figures.map(|figure| vec![figure; 3]));
    }

    #[test]
    fn unit_missing_columns_are_reported_with_their_parameter() {
        let shape = |names: &[&str]| {
            let columns = names.iter().map(|name| Column::float(*name, "", "")).collect();
            TableShape { columns, rate_hz: None }
        };
        let fault_texts = |faults: Vec<Fault>| {
            let one = |f: &Fault| format!("{f} [{}]", f.param.clone().unwrap_or_default());
            faults.iter().map(one).collect::<Vec<_>>()
        };
        let bare = Table::Lines(shape(&["tt"]));
        let faults = fault_texts(stage(None).yields(&[&bare]).unwrap_err());
        for (fault, words) in
            faults.iter().zip([["`mag_c`", "[mag]"], ["`core_field`", "[input]"], ["`map_value`", "[input]"]])
        {
            assert!(words.iter().all(|word| fault.contains(word)), "{fault}");
        }
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(fault_texts(stage(Some("mag_1_c")).yields(&[&bare]).unwrap_err())[1].ends_with("[truth]"));

        let model = |names: &[&str]| Table::Model { shape: shape(names), features: vec![] };
        let faults = fault_texts(AssumeNoise {}.yields(&[&bare, &model(&RESIDUAL[..2])]).unwrap_err());
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert!(faults[0].contains("`residual_noise`") && faults[0].ends_with("[noise]"), "{faults:?}");
        let made = AssumeNoise {}.yields(&[&bare, &model(&RESIDUAL)]).unwrap().columns;
        let made: Vec<_> = made.iter().map(|c| (c.name.as_str(), c.unit.as_str())).collect();
        assert_eq!(made, [("mag_sigma", "nT"), ("mag_fogm_sigma", "nT"), ("mag_fogm_tau", "s")]);
    }
}
