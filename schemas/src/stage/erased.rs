//! Type-erased stages: the only module that erases and restores their types.

use std::{any::Any, ops::Deref, sync::Arc};

use arrow_array::{ArrayRef, RecordBatch};

use super::{
    CheckpointMonitor, LineInput, LinePoint, LineStage, MapStage, Stage, StageOutput, StageSchema, SurveyAggregator,
    SurveyPoint, SurveyStage, Table,
};
use crate::Fault;

/// The columns of a stage for one line, or the fault.
pub type LineOutput = Result<Vec<ArrayRef>, Fault>;

/// The type-erased result of [`LineStage::prepare`].
pub type AnySharedData = Arc<dyn Any + Send + Sync>;

/// The type-erased result of [`SurveyAggregator::map`] for a line.
pub type AnyLinePart = Box<dyn Any + Send>;

/// A stage with its parameters, by grain. Dereferences to a [`StageDyn`].
#[derive(Clone)]
pub enum AnyStage {
    /// A stage that processes one line at a time.
    Line(Arc<dyn LineStageDyn>),
    /// A stage that processes all lines of a survey together.
    Survey(Arc<dyn SurveyStageDyn>),
    /// A stage that processes maps.
    Map(Arc<dyn MapStageDyn>),
}

impl Deref for AnyStage {
    type Target = dyn StageDyn;

    fn deref(&self) -> &(dyn StageDyn + 'static) {
        match self {
            AnyStage::Line(stage) => stage.as_ref(),
            AnyStage::Survey(stage) => stage.as_ref(),
            AnyStage::Map(stage) => stage.as_ref(),
        }
    }
}

impl AnyStage {
    /// The stage, if it works on lines.
    ///
    /// # Errors
    /// Fails for a stage of another grain.
    pub fn of_lines(&self) -> Result<&dyn LineStageDyn, Fault> {
        match self {
            AnyStage::Line(stage) => Ok(stage.as_ref()),
            AnyStage::Survey(_) | AnyStage::Map(_) => Err(other("a line")),
        }
    }

    /// The stage, if it works on surveys.
    ///
    /// # Errors
    /// Fails for a stage of another grain.
    pub fn of_surveys(&self) -> Result<&dyn SurveyStageDyn, Fault> {
        match self {
            AnyStage::Survey(stage) => Ok(stage.as_ref()),
            AnyStage::Line(_) | AnyStage::Map(_) => Err(other("a survey")),
        }
    }

    /// The stage, if it works on maps.
    ///
    /// # Errors
    /// Fails for a stage of another grain.
    pub fn of_maps(&self) -> Result<&dyn MapStageDyn, Fault> {
        match self {
            AnyStage::Map(stage) => Ok(stage.as_ref()),
            AnyStage::Line(_) | AnyStage::Survey(_) => Err(other("a map")),
        }
    }
}

fn other(work: &str) -> Fault {
    Fault::bug(format!("the stage does not work on {work}"))
}

fn another_type() -> Fault {
    Fault::bug("the data belong to another stage")
}

/// A type-erased [`Stage`].
pub trait StageDyn: Send + Sync {
    /// Every parameter in its canonical spelling, without those that are [unused](Stage::unused_key).
    fn canonical(&self) -> Vec<(&'static str, String)>;
    /// See [`Stage::unused_key`].
    fn unused_key(&self, key: &str) -> Option<Fault>;
    /// See [`Stage::effort`].
    fn effort(&self) -> f64;
    /// See [`Stage::manner`].
    fn manner(&self) -> &'static str;
    /// See [`Stage::expressions`].
    fn expressions(&self) -> Vec<(Option<&str>, &str)>;
    /// See [`Stage::memorises`].
    fn memorises(&self) -> bool;
    /// See [`Stage::yields`].
    ///
    /// # Errors
    /// Fails in the cases of [`Stage::yields`].
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>>;
    /// The stage as `Any`, for downcasts.
    fn as_any(&self) -> &dyn Any;
}

impl<S: Stage> StageDyn for S {
    fn canonical(&self) -> Vec<(&'static str, String)> {
        let mut pairs = vec![];
        self.spell(&mut pairs);
        pairs.retain(|(key, _)| Stage::unused_key(self, key).is_none());
        pairs
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        Stage::unused_key(self, key)
    }

    fn effort(&self) -> f64 {
        Stage::effort(self)
    }

    fn manner(&self) -> &'static str {
        Stage::manner(self)
    }

    fn expressions(&self) -> Vec<(Option<&str>, &str)> {
        Stage::expressions(self)
    }

    fn memorises(&self) -> bool {
        Stage::memorises(self)
    }

    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        Stage::yields(self, inputs)
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// A point of a sweep on one line, with a type-erased stage.
#[derive(Clone, Copy)]
pub struct AnyLinePoint<'a> {
    /// The stage with the parameters of the point.
    pub stage: &'a dyn LineStageDyn,
    /// The line.
    pub line: &'a LineInput,
    /// The prepared data of the stage.
    pub prepared: &'a AnySharedData,
}

impl<'a> AnyLinePoint<'a> {
    fn typed<S: LineStage>(&self) -> Result<LinePoint<'a, S>, Fault> {
        let stage = self.stage.as_any().downcast_ref().ok_or_else(another_type)?;
        let prepared = self.prepared.downcast_ref().ok_or_else(another_type)?;
        Ok(LinePoint { stage, line: self.line, prepared })
    }
}

/// A type-erased [`LineStage`].
pub trait LineStageDyn: StageDyn {
    /// See [`LineStage::prepare`].
    ///
    /// # Errors
    /// Fails in the cases of [`LineStage::prepare`].
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<AnySharedData, Fault>;
    /// See [`LineStage::prepare_key`].
    fn prepare_key(&self) -> String;
    /// See [`LineStage::run`].
    ///
    /// # Errors
    /// Fails in the cases of [`LineStage::run`]. Also fails for `prepared` data of another stage.
    fn run(&self, line: &LineInput, prepared: &AnySharedData) -> LineOutput;
    /// See [`LineStage::run_points`]; `self` determines only the type. A point of another stage has a fault.
    fn run_points(&self, points: &[AnyLinePoint]) -> Vec<LineOutput>;
}

impl<S: LineStage> LineStageDyn for S {
    fn prepare(&self, inputs: &[RecordBatch]) -> Result<AnySharedData, Fault> {
        Ok(Arc::new(LineStage::prepare(self, inputs)?))
    }

    fn prepare_key(&self) -> String {
        LineStage::prepare_key(self)
    }

    fn run(&self, line: &LineInput, prepared: &AnySharedData) -> LineOutput {
        let LinePoint { stage, line, prepared } = AnyLinePoint { stage: self, line, prepared }.typed::<S>()?;
        LineStage::run(stage, line, prepared)
    }

    fn run_points(&self, points: &[AnyLinePoint]) -> Vec<LineOutput> {
        let typed: Vec<Result<LinePoint<S>, Fault>> = points.iter().map(AnyLinePoint::typed).collect();
        let ours: Vec<LinePoint<S>> = typed.iter().flatten().copied().collect();
        let mut answers = S::run_points(&ours).into_iter();
        let mut answer = || {
            answers.next().unwrap_or_else(|| Err(Fault::bug("the stage returned fewer results than there are points")))
        };
        typed.into_iter().map(|point| point.and_then(|_| answer())).collect()
    }
}

/// A point of a sweep over the lines of a survey, with a type-erased stage.
#[derive(Clone, Copy)]
pub struct AnySurveyPoint<'a> {
    /// The stage with the parameters of the point.
    pub stage: &'a dyn SurveyStageDyn,
    /// See [`SurveyPoint::inputs`].
    pub inputs: &'a [RecordBatch],
}

/// A type-erased [`SurveyStage`].
pub trait SurveyStageDyn: StageDyn {
    /// See [`SurveyStage::gather`]; `self` determines only the type.
    ///
    /// # Errors
    /// Fails for a point of another stage.
    fn gather(&self, points: &[AnySurveyPoint]) -> Result<Box<dyn SurveyAggregatorDyn>, Fault>;
}

impl<S: SurveyStage> SurveyStageDyn for S {
    fn gather(&self, points: &[AnySurveyPoint]) -> Result<Box<dyn SurveyAggregatorDyn>, Fault> {
        let typed = points.iter().map(|point| {
            let stage = point.stage.as_any().downcast_ref::<S>().ok_or_else(another_type)?;
            Ok(SurveyPoint { stage, inputs: point.inputs })
        });
        Ok(Box::new(S::gather(typed.collect::<Result<_, Fault>>()?)))
    }
}

/// A type-erased [`SurveyAggregator`].
pub trait SurveyAggregatorDyn: Send + Sync {
    /// See [`SurveyAggregator::map`].
    ///
    /// # Errors
    /// Fails in the cases of [`SurveyAggregator::map`].
    fn map(&self, line: &LineInput) -> Result<AnyLinePart, Fault>;
    /// See [`SurveyAggregator::refused`].
    fn refused(&self, part: &AnyLinePart) -> Vec<(usize, Fault)>;
    /// See [`SurveyAggregator::finish`].
    ///
    /// # Errors
    /// Fails for a part of another stage.
    fn finish(
        &self,
        parts: Vec<AnyLinePart>,
        work: &dyn CheckpointMonitor,
    ) -> Result<Vec<Result<StageOutput, Fault>>, Fault>;
}

impl<G: SurveyAggregator> SurveyAggregatorDyn for G {
    fn map(&self, line: &LineInput) -> Result<AnyLinePart, Fault> {
        Ok(Box::new(SurveyAggregator::map(self, line)?))
    }

    fn refused(&self, part: &AnyLinePart) -> Vec<(usize, Fault)> {
        part.downcast_ref().map_or_else(Vec::new, |part| SurveyAggregator::refused(self, part))
    }

    fn finish(
        &self,
        parts: Vec<AnyLinePart>,
        work: &dyn CheckpointMonitor,
    ) -> Result<Vec<Result<StageOutput, Fault>>, Fault> {
        let typed = parts.into_iter().map(|part| part.downcast().map(|part| *part).map_err(|_| another_type()));
        Ok(SurveyAggregator::finish(self, typed.collect::<Result<_, _>>()?, work))
    }
}

/// A type-erased [`MapStage`].
pub trait MapStageDyn: StageDyn {
    /// See [`MapStage::run`].
    ///
    /// # Errors
    /// Fails in the cases of [`MapStage::run`].
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault>;
}

impl<S: MapStage> MapStageDyn for S {
    fn run(&self, maps: &[RecordBatch]) -> Result<StageOutput, Fault> {
        MapStage::run(self, maps)
    }
}
