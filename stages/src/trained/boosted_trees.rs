//! A forest of boosted trees and its table.
//!
//! The field is `base` plus one value of each tree. A tree begins at its node 1. At `split[t,k] NAME`, a row continues
//! at node `left[t,k]` if its `NAME` is at most the value of the split, and otherwise at the node after `left[t,k]`. It
//! ends at a `leaf[t,k]`, which holds the value of the tree. `nodes[t]` is the number of nodes of tree t.

use learning::trees::{BoostingError, Forest, RegressionTree, RegressionTreeNode};
use schemas::Fault;

use super::{
    FieldPrediction,
    terms::{TermLookup, TermValue, broken, list, named_list, term},
};

/// A forest and its columns.
#[derive(Clone, Debug, PartialEq)]
pub struct BoostedTrees {
    inputs: Vec<String>,
    forest: Forest,
}

impl BoostedTrees {
    /// Creates the model from its parts.
    ///
    /// # Errors
    /// Fails if the forest refers to missing columns, or its nodes are not in the order of the layout.
    pub fn new(inputs: Vec<String>, forest: Forest) -> Result<Self, Fault> {
        forest.check(inputs.len()).map_err(|e: BoostingError| broken(e.to_string()))?;
        let together = |node: &RegressionTreeNode| match node {
            RegressionTreeNode::Leaf { .. } => true,
            RegressionTreeNode::Split { left, right, .. } => *right == left + 1,
        };
        if !forest.trees.iter().flat_map(|tree| &tree.nodes).all(together) {
            return Err(broken("the nodes below a split are not consecutive".to_owned()));
        }
        Ok(Self { inputs, forest })
    }

    /// Names of the columns of an input row.
    pub fn columns(&self) -> &[String] {
        &self.inputs
    }

    /// The trees.
    pub fn forest(&self) -> &Forest {
        &self.forest
    }

    /// See [`LearnedModel::predict`](super::LearnedModel::predict).
    pub fn predict(&self, x: &[f64]) -> FieldPrediction {
        FieldPrediction { field_nt: self.forest.predict(x, self.inputs.len()), sigma_nt: None }
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<TermValue> {
        let mut out: Vec<TermValue> = named_list("input", &self.inputs, &vec![1.0; self.inputs.len()]).collect();
        out.push(term("base", self.forest.base));
        let counts: Vec<f64> = self.forest.trees.iter().map(|tree| tree.nodes.len() as f64).collect();
        out.extend(list("nodes", &counts));
        for (t, tree) in self.forest.trees.iter().enumerate() {
            for (k, node) in tree.nodes.iter().enumerate() {
                let at = format!("[{},{}]", t + 1, k + 1);
                match node {
                    RegressionTreeNode::Leaf { value } => out.push(term(format!("leaf{at}"), *value)),
                    RegressionTreeNode::Split { feature, threshold, left, .. } => {
                        let name = self.inputs.get(*feature).map(String::as_str).unwrap_or_default();
                        out.push(term(format!("split{at} {name}"), *threshold));
                        out.push(term(format!("left{at}"), (left + 1) as f64));
                    }
                }
            }
        }
        out
    }

    /// Reads the forest of a table.
    ///
    /// # Errors
    /// Fails if the table is incomplete.
    pub fn read(terms: &TermLookup) -> Result<Self, Fault> {
        let (inputs, _) = terms.list("input")?;
        let base = terms.value("base")?;
        let (_, counts) = terms.list("nodes")?;
        let node = |at: String| {
            let split = format!("split{at}");
            let Ok(name) = terms.word(&split) else {
                return Ok(RegressionTreeNode::Leaf { value: terms.value(&format!("leaf{at}"))? });
            };
            let feature = inputs.iter().position(|input| input == name);
            let feature = feature.ok_or_else(|| broken(format!("`{split}` uses `{name}`, which is not an input")))?;
            let left = terms.count(&format!("left{at}"))?.saturating_sub(1);
            Ok(RegressionTreeNode::Split { feature, threshold: terms.value(&split)?, left, right: left + 1 })
        };
        let tree = |t: usize| {
            let count = terms.count(&format!("nodes[{}]", t + 1))?;
            let nodes = (1..=count).map(|k| node(format!("[{},{k}]", t + 1)));
            Ok(RegressionTree { nodes: nodes.collect::<Result<Vec<_>, Fault>>()? })
        };
        let trees = (0..counts.len()).map(tree).collect::<Result<Vec<_>, Fault>>()?;
        BoostedTrees::new(inputs, Forest { base, trees })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::ops::ControlFlow;

    use learning::trees::{BoostingSettings, boost};

    use super::super::LearnedModel;
    use super::*;

    #[test]
    fn unit_a_forest_is_read_from_complete_tables_in_any_order() {
        let x: Vec<f64> = (0..120).map(|k| f64::from(k * 37 % 61)).collect();
        let y: Vec<f64> = x.chunks(2).map(|x| (0.1 * x[0]).sin() + 0.02 * x[1]).collect();
        let how = BoostingSettings { trees: 3, leaves: 4, least_rows: 4, ..BoostingSettings::default() };
        let forest = boost(&x, 2, &y, &how, None, &mut |_, _, _| ControlFlow::Continue(())).unwrap().forest;
        let learned = LearnedModel::BoostedTrees(BoostedTrees::new(vec!["a".into(), "b c".into()], forest).unwrap());
        let mut terms = learned.terms();
        terms.sort_by(|a, b| b.name.cmp(&a.name));
        let (names, values): (Vec<String>, Vec<f64>) = terms.into_iter().map(|t| (t.name, t.value)).unzip();
        assert_eq!(LearnedModel::read(&names, &values).unwrap(), Some(learned));
        for lost in 0..names.len() {
            let without = [&names[..lost], &names[lost + 1..]].concat();
            let read = LearnedModel::read(&without, &[&values[..lost], &values[lost + 1..]].concat());
            let family = names[lost].starts_with("family");
            assert!(if family { read.unwrap().is_none() } else { read.is_err() }, "{}", names[lost]);
        }
        let of = |key: &str| names.iter().position(|name| name.starts_with(key)).unwrap();
        for (key, wrong) in [("left[2,1]", 1.0), ("left[1,1]", 99.0), ("nodes[1]", 1e6), ("leaf", f64::NAN)] {
            let mut values = values.clone();
            values[of(key)] = wrong;
            assert!(LearnedModel::read(&names, &values).is_err(), "{key}");
        }
    }
}
