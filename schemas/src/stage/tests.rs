use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Float64Array};

use super::*;

crate::stage! {
    /// A number.
    Number = "number", version 1, grain Line, inputs [input: Lines], example "";
    /// The number; a negative one is a fault.
    value: f64, unit "1";
}

crate::stage! {
    /// Another stage.
    Other = "other", version 1, grain Line, inputs [input: Lines], example "";
    /// The number of its columns: none.
    columns: usize, unit "1";
}

impl Stage for Number {
    fn yields(&self, _: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        Ok(StageSchema::append::<&str>(vec![], &[]))
    }
}

impl LineStage for Number {
    type Prepared = f64;
    fn prepare(&self, _: &[RecordBatch]) -> Result<f64, Fault> {
        Ok(self.value)
    }
    fn run(&self, line: &LineInput, prepared: &f64) -> LineOutput {
        assert_eq!(*prepared, self.value);
        let values = vec![self.value; line.line.len()];
        if self.value < 0.0 { Err(Fault::data("negative")) } else { Ok(vec![Arc::new(Float64Array::from(values))]) }
    }
}

impl Stage for Other {
    fn yields(&self, _: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        Ok(StageSchema::append::<&str>(vec![], &[]))
    }
    fn unused_key(&self, key: &str) -> Option<Fault> {
        (key == "columns" && self.columns == 0).then(|| Fault::new("none"))
    }
}

impl LineStage for Other {
    type Prepared = ();
    fn prepare(&self, _: &[RecordBatch]) -> Result<(), Fault> {
        Ok(())
    }
    fn run(&self, _: &LineInput, (): &()) -> LineOutput {
        Ok(vec![])
    }
}

#[test]
fn unit_parameters_without_effect_are_not_in_the_key() {
    let canonical = |columns| StageDyn::canonical(&Other { columns });
    assert_eq!(canonical(0), []);
    assert_eq!(canonical(2), [("columns", "2".to_owned())]);
}

#[test]
fn unit_points_run_one_at_a_time_by_default() {
    let line = LineInput { flight: "1".into(), line: "1.01".into(), inputs: vec![], keep: None };
    let stages: [&dyn LineStageDyn; 4] =
        [&Number { value: 1.0 }, &Number { value: -1.0 }, &Other { columns: 0 }, &Number { value: 2.0 }];
    assert_eq!([Number::entry().name, Other::entry().name], [Number::NAME, Other::NAME]);
    let prepared: Vec<AnySharedData> = stages.iter().filter_map(|stage| stage.prepare(&[]).ok()).collect();
    let points =
        stages.iter().zip(&prepared).map(|(stage, prepared)| AnyLinePoint { stage: *stage, line: &line, prepared });
    let points: Vec<AnyLinePoint> = points.collect();
    let columns = |answers: &[LineOutput]| answers.iter().map(|a| a.as_ref().ok().map(Vec::len)).collect::<Vec<_>>();
    let answers = stages[0].run_points(&points);
    assert_eq!(columns(&answers), [Some(1), None, None, Some(1)], "a point of another stage has a fault");
    let expected: ArrayRef = Arc::new(Float64Array::from(vec![2.0; 4]));
    assert!(answers[3].as_ref().is_ok_and(|arrays| arrays[0].to_data() == expected.to_data()));
    assert_eq!(columns(&stages[2].run_points(&points)), [None, None, Some(0), None]);
    assert!(stages[0].run(&line, &prepared[2]).is_err_and(|fault| fault.owner == crate::FaultOwner::Bug));
}
