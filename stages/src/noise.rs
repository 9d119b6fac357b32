//! The noise that compensation leaves on lines over a known field, and how lines are told of it.

use arrow_array::{ArrayRef, Int64Array, RecordBatch};
use numerics::signal::{
    noise::{Blocks, noise},
    segments::{STEP_TOLERANCE, Usable, sample_rate},
};
use schemas::{
    Arrays, Column, Fault, Gather, LineIn, LineStage, Passes, Product, Shape, Stage, SurveyStage, Table, Yield, stage,
};

use crate::{
    columns::{array, data, floats, shape},
    compensate::{RESIDUAL, noise_columns},
};

stage! {
    /// Finds the noise of a compensated signal on the lines that `where` selects, whose field is known: from another
    /// magnetometer, `truth`, or else from a map, the core field and the temporal variation.
    ///
    /// What a fit sees of its own noise is what it leaves on its calibration lines, geology included, in the manoeuvres of
    /// a calibration. This is the stronger figure: a line as it is flown when navigating, over a map. `assume_noise` gives
    /// it to other lines, and `navigate` takes it from there where its noise is `"auto"`. The error of the map is part of
    /// it. Select other lines than those that are navigated.
    ///
    /// The noise is in two parts, white and first-order Gauss-Markov, the least that bound the Allan variance of the lines,
    /// to which no constant matters. A time constant beyond the length of the lines cannot be told from that length. It
    /// refuses lines without a run of 16 s.
    ///
    /// Source: Allan 1966; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8.
    ResidualNoise = "residual_noise", version 1, grain Survey, inputs [input: Lines],
    example r#"
[[stages]]
name  = "residual_noise"
stage = "residual_noise"
input = "compensate"
truth = "mag_1_c"
"#;
    /// The compensated signal.
    mag: String, unit "nT", default "mag_c";
    /// The column of the true field, such as `mag_1_c`.
    truth: Option<String>, unit "nT", absent "the sum of `igrf`, `map_anomaly` (of `map_value`) and, where there is one, `diurnal`";
}

stage! {
    /// Appends a noise that was found elsewhere, by `residual_noise`: `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau`, the
    /// same for all samples. They take the place of those of `compensate`.
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
    /// What is taken off the signal.
    fn less(&self, there: impl Fn(&str) -> bool) -> Vec<String> {
        match &self.truth {
            Some(truth) => vec![truth.clone()],
            None => ["igrf", "map_anomaly"]
                .into_iter()
                .chain([DIURNAL].into_iter().filter(|n| there(n)))
                .map(str::to_owned)
                .collect(),
        }
    }

    fn needs(&self, shape: &Shape, name: &str) -> Result<(), Fault> {
        let found = shape.number(name, "nT").map(|_| ());
        found.map_err(|fault| match name {
            "igrf" => fault.help("append it with `core_field`, or name the true field with `truth`").of_param("input"),
            "map_anomaly" => {
                fault.help("append it with `map_value`, or name the true field with `truth`").of_param("input")
            }
            _ if name == self.mag => fault.of_param("mag"),
            _ => fault.of_param("truth"),
        })
    }

    fn blocks(&self, batch: &RecordBatch, line: &LineIn) -> Result<Blocks, Fault> {
        let tt = floats(batch, "tt")?;
        let rate_hz = sample_rate(tt, STEP_TOLERANCE).map_err(|e| data(e).in_column("tt").help("resample first"))?;
        let mut left = floats(batch, &self.mag)?.to_vec();
        for name in self.less(|name| batch.column_by_name(name).is_some()) {
            left.iter_mut().zip(floats(batch, &name)?).for_each(|(l, x)| *l -= x);
        }
        let selected = line.keep.as_ref().map_or_else(|| Usable::all(tt.len()), |keep| Usable::selected(keep));
        Ok(Blocks::of(&left, &selected.and_finite(&left).runs_in_time(tt, rate_hz), rate_hz))
    }
}

impl Stage for ResidualNoise {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut reads = vec![self.mag.clone()];
        reads.extend(self.less(|name| shape.get(name).is_some()));
        let faults: Vec<Fault> = reads.iter().filter_map(|name| self.needs(shape, name).err()).collect();
        if !faults.is_empty() {
            return Err(faults);
        }
        reads.push("tt".to_owned());
        let columns = vec![
            Column::float(RESIDUAL[0], "nT", "white part of the noise, a sample"),
            Column::float(RESIDUAL[1], "nT", "Gauss-Markov part of the noise"),
            Column::float(RESIDUAL[2], "s", "time constant of that part"),
            Column::integer("n", "", "samples behind it"),
        ];
        let columns = columns.into_iter().map(|c| c.from(0, &reads)).collect();
        Ok(Yield { passes: Passes::None, ..Yield::append(columns, &reads) })
    }
}

impl SurveyStage for ResidualNoise {
    type Gather = NoiseGather;

    fn gather(points: Vec<&Self>) -> NoiseGather {
        NoiseGather { points: points.into_iter().cloned().collect() }
    }
}

/// The points of a sweep over the lines of a known field.
pub struct NoiseGather {
    points: Vec<ResidualNoise>,
}

/// The residual of one line at each point of a sweep.
pub struct Part {
    blocks: Vec<Result<Blocks, Fault>>,
}

impl Gather for NoiseGather {
    type Part = Part;

    fn map(&self, line: &LineIn) -> Result<Part, Fault> {
        let blocks = self.points.iter().map(|p| p.blocks(&line.inputs[0], line));
        Ok(Part { blocks: blocks.map(|b| b.map_err(|f| f.in_line(&line.flight, &line.line))).collect() })
    }

    fn finish(&self, parts: Vec<Part>) -> Vec<Result<Product, Fault>> {
        (0..self.points.len())
            .map(|i| {
                let lines: Vec<Blocks> = parts.iter().map(|p| p.blocks[i].clone()).collect::<Result<_, _>>()?;
                let found = noise(&lines).map_err(|e| data(e).help("select longer lines with `where`"))?;
                let block = |l: &Blocks| (l.block_s / l.step_s).round() as i64;
                let n: i64 = lines.iter().map(|l| block(l) * l.runs.iter().map(Vec::len).sum::<usize>() as i64).sum();
                let one = |x: f64| array(vec![x]);
                let n: ArrayRef = std::sync::Arc::new(Int64Array::from(vec![n]));
                Ok(vec![one(found.white_nt), one(found.lasting.sigma), one(found.lasting.tau_s), n].into())
            })
            .collect()
    }
}

impl Stage for AssumeNoise {
    fn yields(&self, inputs: &[&Table]) -> Result<Yield, Vec<Fault>> {
        let noise = shape(inputs, 1)?;
        if RESIDUAL.iter().any(|name| noise.get(name).is_none()) {
            let what = "`noise` says nothing of a noise";
            return Err(vec![
                Fault::new(what).help("name the table of a `residual_noise` or a `fit`").of_param("noise"),
            ]);
        }
        let mut yields = Yield::append(noise_columns(&RESIDUAL), &["tt"]);
        yields.reads.push(RESIDUAL.map(str::to_owned).to_vec());
        Ok(yields)
    }
}

impl LineStage for AssumeNoise {
    type Prepared = [f64; 3];

    fn run(&self, line: &LineIn, noise: &[f64; 3]) -> Arrays {
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
