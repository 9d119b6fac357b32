//! Training of the network of the filter `nekf`.

use std::{ops::ControlFlow, sync::Arc};

use arrow_array::StringArray;
use numerics::{
    earth::core_field::CoreField,
    navigation::{
        ins_error::{InsErrorModel, InsErrorSpec},
        ins_series::InsSeries,
        line::NavigationLine,
        nekf::{NetworkNoise, NoiseLoss, NoiseTraining, TrainedNoise, TrainingLine, train},
        output::NavigationError,
    },
};
use schemas::{
    CheckpointMonitor, ChoiceSelection, Column, Fault, LineInput, LinePoint, LineStage, PassThroughColumns, Role, Rule,
    Stage, StageOutput, StageSchema, SurveyAggregator, SurveyPoint, SurveyStage, Table, stage,
};

use crate::{
    columns::{array, data, faults_of, floats, shape},
    model_columns::RATE,
    navigate::{
        FieldKeys, FilterGroups, FilterInput, FilterTrack, MeasurementNoise, Navigate, NavigationFilter, NavigationMap,
        NavigationResources, Nekf, SensorGeometry, StartKeys, feature_faults, features_of, is_near_rate, mean_rate_hz,
        network_terms, with_filter_input,
    },
    trained::{list, term},
};

stage! {
    /// Trains, on the lines that `where` selects, the network that sets the noise of the filter `nekf`. Do not select
    /// the lines that are navigated: their scores would be in sample.
    ///
    /// Training minimises the negative log-likelihood of the innovations, which requires no truth. With `loss =
    /// "position"`, it minimises the negative log-likelihood of the true position, `lat` and `lon`. The derivatives of
    /// the loss are propagated back through the network and through the covariance and state of the filter. Lines are
    /// prepared as in `navigate`. Give the shared keys the same values in both stages. With `tuning = "auto"` the noise
    /// of each line is estimated first, and the network learns how the noise changes along the line.
    ///
    /// The table holds the weights, the scaling of the inputs, and the mean loss of each epoch (`epoch_loss`;
    /// `initial_loss` is the loss of `ekf`). If the loss does not decrease, the inputs do not predict the noise, and
    /// the filter equals `ekf`. The filter runs over whole lines, and rows that `where` does not select have no
    /// measurement. Lines with different sample rates are rejected.
    ///
    /// Source: Gnadt 2022, section 5.9.3; Kingma & Ba 2015.
    NoiseNetworkStage = "noise_network", version 1, grain Survey, inputs [input: Lines, map: Map],
    groups [field: FieldKeys, noise: MeasurementNoise, start: StartKeys, geometry: SensorGeometry, ins: InsErrorSpec],
    example r#"
[[stages]]
name            = "noise_network"
stage           = "noise_network"
input           = "assume_noise"
map             = "anomaly"
offset_window_s = 1.0
core_field      = false
epochs          = 2
"#;
    /// Noise that the network sets: measurement noise (`"r"`), noise of the temporal variation (`"q"`), or both.
    network_noise: NetworkNoise, unit "", default NetworkNoise::R;
    /// Quantity whose negative log-likelihood is the loss: the innovations (`likelihood`) or the true position
    /// (`position`).
    loss: NoiseLoss, unit "", default NoiseLoss::Likelihood;
    /// Columns that are additional inputs of the network, such as electric currents. Values that are not finite are
    /// rejected.
    features: Option<Vec<String>>, unit "", absent "none";
    /// Number of units in the long short-term memory layer of the network.
    hidden: usize, unit "1", default 8usize, rule Rule::Between(1.0, 256.0);
    /// Largest factor by which the network multiplies a standard deviation. The smallest factor is 1/`limit`.
    limit: f64, unit "1", default 10.0, rule Rule::Between(1.01, 1e4);
    /// Number of passes through the lines.
    epochs: usize, unit "1", default 30usize, rule Rule::Between(1.0, 1e5);
    /// Time span over which derivatives are propagated back.
    window_s: f64, unit "s", default 200.0, rule Rule::Positive;
    /// Learning rate of the first step. The rate then falls to 0 along half a period of a cosine.
    learning_rate: f64, unit "1", default 0.01, rule Rule::Positive;
    /// Seed of the initial weights.
    seed: usize, unit "", default 0usize;
}

/// Columns of the true position.
const TRUTH: [&str; 2] = ["lat", "lon"];

/// Filter that takes the place of `nekf` while lines are prepared.
struct PreparingFilter;

impl FilterGroups for PreparingFilter {
    fn groups(&self) -> Vec<&dyn std::any::Any> {
        vec![]
    }
}

impl NavigationFilter for PreparingFilter {
    fn navigate(&self, _: &FilterInput) -> Result<FilterTrack, Fault> {
        Err(Fault::bug("a filter that only prepares lines for training cannot navigate"))
    }
}

impl NoiseNetworkStage {
    /// The navigation that prepares the lines.
    fn navigation(&self) -> Navigate {
        Navigate {
            filter: ChoiceSelection::new(&Nekf::FILTER, Arc::new(PreparingFilter)),
            field: self.field.clone(),
            noise: self.noise.clone(),
            start: self.start.clone(),
            geometry: self.geometry.clone(),
            ins: self.ins,
        }
    }

    fn features(&self) -> &[String] {
        self.features.as_deref().unwrap_or_default()
    }

    /// Columns read in addition to those of the navigation.
    fn further_columns(&self) -> Vec<String> {
        let truth = TRUTH.iter().filter(|_| self.loss == NoiseLoss::Position).map(ToString::to_string);
        self.features().iter().cloned().chain(truth).collect()
    }

    fn training(&self, rate_hz: f64) -> NoiseTraining {
        NoiseTraining {
            noise: self.network_noise,
            loss: self.loss,
            hidden: self.hidden,
            limit: self.limit,
            epochs: self.epochs,
            window: (self.window_s * rate_hz).round().max(1.0) as usize,
            learning_rate: self.learning_rate,
            seed: self.seed as u64,
        }
    }
}

impl Stage for NoiseNetworkStage {
    fn effort(&self) -> f64 {
        self.epochs as f64
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        self.geometry.unused_key(key)
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let lines = shape(inputs, 0)?;
        let mut faults = feature_faults(lines, self.features());
        if self.loss == NoiseLoss::Position {
            faults.extend(faults_of(TRUTH.map(|name| lines.number(name, "deg")), "loss"));
        }
        let navigation = self.navigation().yields(inputs).map_err(|more| faults.extend(more)).ok();
        let Some(navigation) = navigation.filter(|_| faults.is_empty()) else { return Err(faults) };
        let mut reads = navigation.reads;
        let Some(of_lines) = reads.first_mut() else { return Err(vec![Fault::bug("the input is missing")]) };
        let further: Vec<String> = self.further_columns().into_iter().filter(|name| !of_lines.contains(name)).collect();
        of_lines.extend(further);
        let columns = [
            Column::text("model", "name of the model").role(Role::Key),
            Column::text("term", "name of the term").role(Role::Key),
            Column::float("value", "", "value of the term"),
            Column::float("std", "", "always NaN, because the standard deviation is unknown"),
            Column::float("n", "1", "number of samples that contribute to the loss"),
            Column::float(RATE, "Hz", "sample rate of the lines"),
        ];
        let made = |column: Column| reads.iter().enumerate().fold(column, |column, (at, names)| column.from(at, names));
        let columns = columns.into_iter().map(made).collect();
        Ok(StageSchema {
            reads: reads.clone(),
            passes: PassThroughColumns::None,
            notes: navigation.notes,
            ..StageSchema::append(columns, &reads[0])
        })
    }
}

impl SurveyStage for NoiseNetworkStage {
    type Gather = NoiseNetworkAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> NoiseNetworkAggregator {
        let of = |point: SurveyPoint<Self>| {
            let navigation = point.stage.navigation();
            let prepared = navigation.prepare(point.inputs);
            TrainingPoint { stage: point.stage.clone(), navigation, prepared }
        };
        NoiseNetworkAggregator { points: points.into_iter().map(of).collect() }
    }
}

/// Point of a sweep.
struct TrainingPoint {
    stage: NoiseNetworkStage,
    navigation: Navigate,
    prepared: Result<NavigationResources, Fault>,
}

/// Points of a sweep over the same lines.
pub struct NoiseNetworkAggregator {
    points: Vec<TrainingPoint>,
}

/// Training line, with its name.
pub struct PreparedLine {
    name: String,
    columns: [Vec<f64>; 13],
    measured_nt: Vec<f64>,
    sigma_nt: Vec<f64>,
    map: Arc<NavigationMap>,
    core: Option<Arc<CoreField>>,
    errors: InsErrorModel,
    offset_window_s: f64,
    second_order: bool,
    further: Vec<f64>,
    truth: Option<[Vec<f64>; 2]>,
}

impl PreparedLine {
    fn new(
        point: &TrainingPoint,
        line: &LineInput,
        flown: &FilterInput,
        map: Arc<NavigationMap>,
    ) -> Result<Self, Fault> {
        let ins = &flown.ins;
        let InsSeries { tt_s, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps, .. } = *ins;
        let InsSeries { fn_mps2, fe_mps2, fd_mps2, roll_deg, pitch_deg, yaw_deg, .. } = *ins;
        let columns = [
            tt_s, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps, fn_mps2, fe_mps2, fd_mps2, roll_deg, pitch_deg,
            yaw_deg,
        ];
        let mut measured_nt = flown.measured_nt.clone();
        for (measured, keep) in measured_nt.iter_mut().zip(line.keep.iter().flatten()) {
            *measured = if *keep { *measured } else { f64::NAN };
        }
        let truth = match point.stage.loss {
            NoiseLoss::Position => {
                let [lat, lon] = TRUTH.map(|name| floats(flown.columns, name).map(<[f64]>::to_vec));
                Some([lat?, lon?])
            }
            NoiseLoss::Likelihood => None,
        };
        Ok(Self {
            name: format!("{}/{}", line.flight, line.line),
            columns: columns.map(<[f64]>::to_vec),
            measured_nt,
            sigma_nt: flown.sigma_nt.clone(),
            map,
            core: flown.core.clone(),
            errors: flown.errors,
            offset_window_s: flown.offset_window_s,
            second_order: flown.second_order,
            further: features_of(flown, point.stage.features())?,
            truth,
        })
    }

    fn rate_hz(&self) -> f64 {
        mean_rate_hz(&self.columns[0])
    }

    fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    fn training<'a>(&'a self, ins: &'a InsSeries<'a>) -> TrainingLine<'a> {
        let line = NavigationLine {
            ins,
            measurement_nt: &self.measured_nt,
            sigma_nt: &self.sigma_nt,
            map: &self.map.field,
            core: self.core.as_ref(),
            errors: self.errors,
            offset_window_s: self.offset_window_s,
            fixes: None,
            second_order: self.second_order,
        };
        let truth = self.truth.as_ref().map(|truth| truth.each_ref().map(Vec::as_slice));
        TrainingLine { line, further: &self.further, truth }
    }
}

impl SurveyAggregator for NoiseNetworkAggregator {
    type Part = Vec<Result<PreparedLine, Fault>>;

    fn map(&self, line: &LineInput) -> Result<Self::Part, Fault> {
        let of = |point: &TrainingPoint| {
            let prepared = point.prepared.as_ref().map_err(Clone::clone)?;
            let place = LinePoint { stage: &point.navigation, line, prepared };
            with_filter_input(place, |flown, map| PreparedLine::new(point, line, flown, map))
        };
        Ok(self.points.iter().map(of).collect())
    }

    fn refused(&self, part: &Self::Part) -> Vec<(usize, Fault)> {
        part.iter().enumerate().filter_map(|(at, line)| Some((at, line.as_ref().err()?.clone()))).collect()
    }

    fn finish(&self, parts: Vec<Self::Part>, work: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let of = |(at, point): (usize, &TrainingPoint)| {
            let lines: Vec<&PreparedLine> = parts.iter().filter_map(|part| part[at].as_ref().ok()).collect();
            let rate_hz = common_rate_hz(&lines)?;
            let trained = trained(&lines, &point.stage.training(rate_hz), |epoch, loss| {
                match work.report_progress(at, &format!("epoch {epoch}, loss {loss:.4}")) {
                    ControlFlow::Continue(()) => Ok(()),
                    ControlFlow::Break(()) => Err(Fault::machine("interrupted")),
                }
            })?;
            Ok(table(&trained, point.stage.features(), rate_hz))
        };
        self.points.iter().enumerate().map(of).collect()
    }
}

/// Sample rate of all lines, in Hz.
fn common_rate_hz(lines: &[&PreparedLine]) -> Result<f64, Fault> {
    let [first, rest @ ..] = lines else { return Err(Fault::data("no line can be used for training")) };
    match rest.iter().find(|line| !is_near_rate(line.rate_hz(), first.rate_hz())) {
        Some(other) => {
            let (name, other_name) = (&first.name, &other.name);
            let what = format!(
                "the line {name} has {:.3} Hz, but {other_name} has {:.3} Hz",
                first.rate_hz(),
                other.rate_hz()
            );
            Err(Fault::data(what).help("add a `resample` stage before this one"))
        }
        None => Ok(first.rate_hz()),
    }
}

/// Reason why a training ends early.
enum TrainingFault {
    Navigation(NavigationError),
    Progress(Fault),
}

impl From<NavigationError> for TrainingFault {
    fn from(error: NavigationError) -> Self {
        Self::Navigation(error)
    }
}

fn trained(
    lines: &[&PreparedLine],
    training: &NoiseTraining,
    mut progress: impl FnMut(usize, f64) -> Result<(), Fault>,
) -> Result<TrainedNoise, Fault> {
    let series: Vec<InsSeries<'_>> = lines.iter().map(|line| line.series()).collect();
    let all: Vec<TrainingLine<'_>> = lines.iter().zip(&series).map(|(line, ins)| line.training(ins)).collect();
    let found = train(&all, training, |epoch, loss| progress(epoch, loss).map_err(TrainingFault::Progress));
    found.map_err(|fault| match fault {
        TrainingFault::Navigation(error) => data(error),
        TrainingFault::Progress(fault) => fault,
    })
}

/// Table of a trained network. A loss that has not fallen gives a warning.
fn table(trained: &TrainedNoise, features: &[String], rate_hz: f64) -> StageOutput {
    let mut terms = network_terms(&trained.network, features);
    terms.push(term("initial_loss", trained.initial_loss));
    terms.extend(list("epoch_loss", &trained.epoch_loss));
    let rows = terms.len();
    let names: StringArray = terms.iter().map(|term| Some(term.name.as_str())).collect();
    let models: StringArray = std::iter::repeat_n(Some("noise_network"), rows).collect();
    let columns = vec![
        Arc::new(models) as arrow_array::ArrayRef,
        Arc::new(names),
        array(terms.iter().map(|term| term.value).collect()),
        array(vec![f64::NAN; rows]),
        array(vec![trained.samples as f64; rows]),
        array(vec![rate_hz; rows]),
    ];
    let last = trained.epoch_loss.last().copied().unwrap_or(f64::INFINITY);
    let fell = last < trained.initial_loss;
    let warning = || {
        let initial = trained.initial_loss;
        format!("training did not reduce the loss: {initial:.4} without the network, {last:.4} in the last epoch")
    };
    StageOutput { warnings: if fell { vec![] } else { vec![warning()] }, ..columns.into() }
}
