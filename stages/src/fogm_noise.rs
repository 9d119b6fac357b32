//! Noise of a residual: fit of white and first-order Gauss-Markov noise.

use std::sync::Arc;

use arrow_array::{ArrayRef, Int64Array, RecordBatch};
use numerics::signal::{
    noise::{NoiseFitStatistic, fit},
    segments::RowMask,
};
use schemas::{
    CheckpointMonitor, Column, Fault, LineInput, PassThroughColumns, Stage, StageOutput, StageSchema, SurveyAggregator,
    SurveyPoint, SurveyStage, Table, stage,
};

use crate::{
    columns::{array, data, even_rate_hz, floats, shape},
    model_columns::RESIDUAL,
};

stage! {
    /// Fits white noise and first-order Gauss-Markov noise to a residual, on the lines that `where` selects. The
    /// standard deviation and the time constant of the Gauss-Markov noise can be used as `fogm_sigma_nt` and
    /// `fogm_tau_s` of `navigate`. The white noise can be used as `measurement_sigma_nt`. `assume_noise` reads the
    /// table.
    ///
    /// The residual is `column`, minus `truth` if that is set. Examples are a compensated signal minus the true signal,
    /// the variation at a base station, and the `residual` of a track without measurement updates. `residual_noise`
    /// gives the smallest noise that bounds a signal over every time span, for a cautious filter. `fogm_noise` gives
    /// the best fit for noise with one time scale. Noise with several time scales is represented only in part.
    ///
    /// A run is a stretch of samples without a gap. `autocorrelation` fits the variance minus the autocovariance at
    /// lags from one sample to a quarter of the longest run. `allan` fits the Allan variance. A constant affects
    /// neither statistic. If the Gauss-Markov noise is not significant, its standard deviation is 0 and the time
    /// constant is the sample interval. The white noise is at least 0.01 nT.
    ///
    /// These are rejected: records without a run of 64 samples, constant records, and lines with different sample
    /// rates. A record must also last at least 20 time constants in total, and at least 8 in its longest run. A shorter
    /// record does not determine the time constant.
    ///
    /// Source: Cressie 1993, section 2.6; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8.
    FogmNoise = "fogm_noise", version 1, grain Survey, inputs [input: Lines],
    example r#"
[[stages]]
name   = "fogm_noise"
stage  = "fogm_noise"
input  = "compensate"
column = "mag_c"
truth  = "mag_1_c"
"#;
    /// Column of the residual, or of the signal from which `truth` is subtracted.
    column: String, unit "nT", default "residual";
    /// Column that is subtracted from `column`, such as `mag_1_c`.
    truth: Option<String>, unit "nT", absent "nothing is subtracted";
    /// Statistic that is fitted.
    method: NoiseFitStatistic, unit "", default NoiseFitStatistic::Autocorrelation;
}

impl FogmNoise {
    /// Residual of a line, run by run.
    fn runs(&self, batch: &RecordBatch, line: &LineInput) -> Result<ResidualRuns, Fault> {
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        let mut left = floats(batch, &self.column)?.to_vec();
        if let Some(truth) = &self.truth {
            left.iter_mut().zip(floats(batch, truth)?).for_each(|(l, x)| *l -= x);
        }
        let selected = line.keep.as_ref().map_or_else(|| RowMask::all(tt.len()), |keep| RowMask::selected(keep));
        let runs = selected.and_finite(&left).runs_in_time(tt, rate_hz);
        Ok(ResidualRuns { rate_hz, runs: runs.into_iter().map(|run| left[run].to_vec()).collect() })
    }
}

impl Stage for FogmNoise {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let named = [(Some(&self.column), "column"), (self.truth.as_ref(), "truth")];
        let named = || named.iter().filter_map(|(name, param)| name.map(|name| (name, *param)));
        let faults: Vec<Fault> =
            named().filter_map(|(name, param)| Some(shape.number(name, "nT").err()?.of_param(param))).collect();
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads: Vec<&str> = named().map(|(name, _)| name.as_str()).chain(["tt"]).collect();
        let columns = vec![
            Column::float(RESIDUAL[0], "nT", "standard deviation of the white noise of one sample"),
            Column::float(RESIDUAL[1], "nT", "standard deviation of the Gauss-Markov noise"),
            Column::float(RESIDUAL[2], "s", "time constant of the Gauss-Markov noise"),
            Column::integer("n", "", "number of samples used"),
        ];
        let columns = columns.into_iter().map(|c| c.from(0, &reads)).collect();
        Ok(StageSchema { passes: PassThroughColumns::None, ..StageSchema::append(columns, &reads) })
    }
}

impl SurveyStage for FogmNoise {
    type Gather = FogmAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> FogmAggregator {
        FogmAggregator { points: points.into_iter().map(|point| point.stage.clone()).collect() }
    }
}

/// Points of a sweep over the residuals of the same lines.
pub struct FogmAggregator {
    points: Vec<FogmNoise>,
}

/// Residual of one line at each point of a sweep.
pub struct FogmLineResidual {
    lines: Vec<Result<ResidualRuns, Fault>>,
}

/// Runs of samples without a gap.
#[derive(Clone)]
struct ResidualRuns {
    rate_hz: f64,
    runs: Vec<Vec<f64>>,
}

impl SurveyAggregator for FogmAggregator {
    type Part = FogmLineResidual;

    fn map(&self, line: &LineInput) -> Result<FogmLineResidual, Fault> {
        let lines = self.points.iter().map(|p| p.runs(&line.inputs[0], line));
        Ok(FogmLineResidual { lines: lines.map(|l| l.map_err(|f| f.in_line(&line.flight, &line.line))).collect() })
    }

    fn finish(&self, parts: Vec<FogmLineResidual>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let of = |(i, point): (usize, &FogmNoise)| {
            let lines: Vec<&ResidualRuns> =
                parts.iter().map(|p| p.lines[i].as_ref().map_err(Clone::clone)).collect::<Result<_, _>>()?;
            found(point, &lines)
        };
        self.points.iter().enumerate().map(of).collect()
    }
}

/// Noise of all lines.
fn found(point: &FogmNoise, lines: &[&ResidualRuns]) -> Result<StageOutput, Fault> {
    let rate_hz = lines.first().map_or(1.0, |line| line.rate_hz);
    if let Some(other) = lines.iter().find(|line| (line.rate_hz / rate_hz - 1.0).abs() > 1e-6) {
        let what = format!("the lines have different sample rates: {rate_hz} and {} Hz", other.rate_hz);
        return Err(Fault::data(what)
            .in_column("tt")
            .help("add a `resample` stage, so that all lines have the same rate"));
    }
    let runs: Vec<&[f64]> = lines.iter().flat_map(|line| &line.runs).map(Vec::as_slice).collect();
    let noise = fit(&runs, rate_hz, point.method).map_err(|e| {
        let help = "select longer lines with `where`, or use the bound of `residual_noise`";
        data(e).in_column(&point.column).help(help)
    })?;
    let n: i64 = runs.iter().map(|run| run.len() as i64).sum();
    let n: ArrayRef = Arc::new(Int64Array::from(vec![n]));
    let one = |x: f64| array(vec![x]);
    Ok(vec![one(noise.white_nt), one(noise.lasting.sigma), one(noise.lasting.tau_s), n].into())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{
        cast::AsArray,
        types::{Float64Type, Int64Type},
    };
    use numerics::{random::NormalGenerator, signal::gauss_markov::GaussMarkov};
    use schemas::TableShape;

    use super::*;

    const PROCESS: GaussMarkov = GaussMarkov { sigma: 4.0, tau_s: 20.0 };

    fn stage(method: NoiseFitStatistic, truth: Option<&str>) -> FogmNoise {
        FogmNoise { column: "residual".into(), truth: truth.map(str::to_owned), method }
    }

    fn line(rate_hz: f64, columns: Vec<(&str, Vec<f64>)>) -> LineInput {
        let tt = (0..columns[0].1.len()).map(|k| k as f64 / rate_hz).collect();
        let columns = [("tt", tt)].into_iter().chain(columns);
        let batch = RecordBatch::try_from_iter(columns.map(|(name, values)| (name, array(values)))).unwrap();
        LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![batch], keep: None }
    }

    /// Realisation of the process plus white noise of 1 nT, at 10 Hz.
    fn noisy(seconds: f64, seed: u64) -> Vec<f64> {
        let tt: Vec<f64> = (0..(10.0 * seconds) as usize).map(|k| 0.1 * k as f64).collect();
        let mut normals = NormalGenerator::new(seed);
        let lasting = PROCESS.realisation(&tt, || normals.draw());
        lasting.into_iter().map(|x| x + normals.draw()).collect()
    }

    /// Estimates of the white noise and of the standard deviation and time constant of the process; and the number of
    /// samples.
    fn estimate_noise(stage: &FogmNoise, lines: &[LineInput]) -> Result<([f64; 3], i64), Fault> {
        let gather = FogmNoise::gather(vec![crate::testing::point(stage)]);
        let parts = lines.iter().map(|line| gather.map(line).unwrap()).collect();
        let columns = gather.finish(parts, &schemas::NullMonitor).remove(0)?.columns;
        let figure = |k: usize| columns[k].as_primitive::<Float64Type>().value(0);
        Ok(([0, 1, 2].map(figure), columns[3].as_primitive::<Int64Type>().value(0)))
    }

    #[test]
    fn law_sigma_and_time_constant_of_a_known_noise_are_found() {
        for method in [NoiseFitStatistic::Autocorrelation, NoiseFitStatistic::Allan] {
            let lines: Vec<LineInput> =
                (0..12).map(|seed| line(10.0, vec![("residual", noisy(600.0, seed))])).collect();
            let ([white, sigma, tau], n) = estimate_noise(&stage(method, None), &lines).unwrap();
            assert_eq!(n, 12 * 6000);
            // 7200 s are 360 time constants. The errors are 4 % (standard deviation) and 11 % (time constant); the
            // limits are 2.5 times these.
            assert!((white - 1.0).abs() < 0.03, "{white}");
            assert!((sigma / 4.0 - 1.0).abs() < 0.1 && (tau / 20.0 - 1.0).abs() < 0.27, "{sigma} {tau}");
        }
    }

    #[test]
    fn unit_subtracted_fields_and_unselected_rows_do_not_matter() {
        let (noise, truth) = (noisy(3000.0, 1), (0..30_000).map(|k| 5e4 + 0.1 * f64::from(k)).collect::<Vec<_>>());
        let sum: Vec<f64> = noise.iter().zip(&truth).map(|(a, b)| a + b).collect();
        let (plain, less) = (
            stage(NoiseFitStatistic::Autocorrelation, None),
            stage(NoiseFitStatistic::Autocorrelation, Some("mag_1_c")),
        );
        let alone = estimate_noise(&plain, &[line(10.0, vec![("residual", noise.clone())])]).unwrap();
        let together = estimate_noise(&less, &[line(10.0, vec![("residual", sum), ("mag_1_c", truth)])]).unwrap();
        // The tolerance is the square root of the rounding error at 50,000 nT, because the minimum of the objective is
        // flat.
        assert!((0..3).all(|k| (alone.0[k] / together.0[k] - 1.0).abs() < 1e-4), "{alone:?} {together:?}");
        let (mut spoilt, mut missing) = (noise.clone(), noise);
        spoilt[20_000..].fill(1e6);
        missing[20_000..].fill(f64::NAN);
        let keep = Some((0..30_000).map(|k| k < 20_000).collect());
        let selected = LineInput { keep, ..line(10.0, vec![("residual", spoilt)]) };
        assert_eq!(
            estimate_noise(&plain, &[selected]).unwrap(),
            estimate_noise(&plain, &[line(10.0, vec![("residual", missing)])]).unwrap()
        );
    }

    #[test]
    fn unit_too_short_records_are_rejected_with_a_remedy() {
        let plain = stage(NoiseFitStatistic::Autocorrelation, None);
        let fault = |lines: &[LineInput]| estimate_noise(&plain, lines).unwrap_err();
        let short = fault(&[line(10.0, vec![("residual", noisy(60.0, 2))])]);
        assert!(short.what.contains("too short for its correlation time"), "{short}");
        assert!(short.help.unwrap().contains("`residual_noise`"));
        assert!(fault(&[line(10.0, vec![("residual", noisy(5.0, 2))])]).what.contains("64 samples"));
        assert!(fault(&[line(10.0, vec![("residual", vec![3.0; 600])])]).what.contains("constant"));
        assert!(fault(&[line(10.0, vec![("residual", vec![f64::NAN; 600])])]).what.contains("longest has 0"));
        let rates = [10.0, 20.0].map(|rate_hz| line(rate_hz, vec![("residual", noisy(600.0, 3))]));
        assert!(fault(&rates).what.contains("10 and 20 Hz"));
        let single = fault(&[line(10.0, vec![("residual", vec![1.0])])]);
        assert!(single.what.contains("at least 2") && single.place.column.as_deref() == Some("tt"), "{single:?}");
    }

    #[test]
    fn unit_missing_columns_are_reported_with_their_parameter() {
        let columns = vec![Column::float("tt", "s", ""), Column::float("residual", "m", "")];
        let table = Table::Lines(TableShape { columns: columns.into(), rate_hz: None });
        let faults = stage(NoiseFitStatistic::Allan, Some("mag_1_c")).yields(&[&table]).unwrap_err();
        let found: Vec<_> = faults.iter().map(|f| (f.what.as_str(), f.param.as_deref().unwrap())).collect();
        let expected =
            [("column `residual` is in m, but nT is needed", "column"), ("there is no column `mag_1_c`", "truth")];
        assert_eq!(found, expected);
    }
}
