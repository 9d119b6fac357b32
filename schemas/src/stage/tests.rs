use arrow_array::{Array, Float64Array};

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
    fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
        Ok(Yield::append::<&str>(vec![], &[]))
    }
    fn run(&self, line: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        let values = vec![self.value; line.line.len()];
        if self.value < 0.0 { Err(Fault::data("negative")) } else { Ok(vec![Arc::new(Float64Array::from(values))]) }
    }
}

impl Stage for Other {
    fn yields(&self, _: &[&Table]) -> Result<Yield, Vec<Fault>> {
        Ok(Yield::append::<&str>(vec![], &[]))
    }
    fn idle(&self, key: &str) -> Option<Fault> {
        (key == "columns" && self.columns == 0).then(|| Fault::new("none"))
    }
    fn run(&self, _: &LineIn) -> Result<Vec<ArrayRef>, Fault> {
        Ok(vec![])
    }
}

#[test]
fn law_what_has_no_say_is_not_in_the_key() {
    let canonical = |columns| StageDyn::canonical(&Other { columns });
    assert_eq!(canonical(0), []);
    assert_eq!(canonical(2), [("columns", "2".to_owned())]);
}

#[test]
fn law_points_are_run_each_by_itself_unless_the_stage_knows_better() {
    let line = LineIn { flight: "1".into(), line: "1.01".into(), inputs: vec![], keep: None, prepared: None };
    let (one, bad, two) = (Number { value: 1.0 }, Number { value: -1.0 }, Number { value: 2.0 });
    let points: [(&dyn StageDyn, &LineIn); 4] =
        [(&one, &line), (&bad, &line), (&Other { columns: 0 }, &line), (&two, &line)];
    assert_eq!([Number::entry().name, Other::entry().name], [Number::NAME, Other::NAME]);
    for first in [&one as &dyn StageDyn, &Other { columns: 0 }] {
        let answers = first.run_points(&points);
        let columns: Vec<Option<usize>> = answers.iter().map(|a| a.as_ref().ok().map(Vec::len)).collect();
        assert_eq!(columns, [Some(1), None, Some(0), Some(1)]);
        let expected: ArrayRef = Arc::new(Float64Array::from(vec![2.0; 4]));
        assert!(answers[3].as_ref().is_ok_and(|arrays| arrays[0].to_data() == expected.to_data()));
    }
}
