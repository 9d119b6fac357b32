//! `$axis`: references to an axis in a stage, and the substitution of its value.

use schemas::{Fault, Literal, SpecEntries, SpecEntry, SpecSection};

use super::grid::SweepPoint;
use crate::spec::{Spec, SpecSpan, StageDecl, TRIAL};

/// The axis names after `$` in a string; `$$` is a literal `$`.
fn mentions(text: &str) -> Vec<&str> {
    let mut found = vec![];
    let mut rest = text;
    while let Some(i) = rest.find('$') {
        rest = &rest[i + 1..];
        if let Some(after) = rest.strip_prefix('$') {
            rest = after;
            continue;
        }
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
        found.push(&rest[..end]);
        rest = &rest[end..];
    }
    found
}

fn mentions_in<'a>(value: &'a Literal, found: &mut Vec<&'a str>) {
    match value {
        Literal::Text(text) => found.extend(mentions(text)),
        Literal::List(items) => items.iter().for_each(|v| mentions_in(v, found)),
        Literal::Section(section) => section.keys.values().for_each(|given| mentions_in(&given.value, found)),
        Literal::Bool(_) | Literal::Int(_) | Literal::Float(_) => {}
    }
}

/// The axes that the declaration of a stage mentions, as positions in the spec.
///
/// # Errors
/// Fails if the stage mentions an axis that the spec does not have.
pub fn mentioned(stage: &StageDecl, spec: &Spec) -> Result<Vec<usize>, Vec<Fault>> {
    let mut found: Vec<(&str, SpecSpan)> = vec![];
    for given in stage.args.values() {
        let mut names = vec![];
        mentions_in(&given.value, &mut names);
        found.extend(names.into_iter().map(|n| (n, given.at.clone())));
    }
    if let Some((text, at)) = &stage.predicate {
        found.extend(mentions(text).into_iter().map(|n| (n, at.clone())));
    }
    let known: Vec<&str> = spec.axes.iter().map(|a| a.name.as_str()).collect();
    let (mut axes, mut faults) = (vec![], vec![]);
    for (name, at) in found {
        match spec.axis(name) {
            Some(i) => axes.push(i),
            None => faults.push(Fault::new(format!("there is no axis `{name}`")).nearest(name, &known).at(at)),
        }
    }
    // A trial sets all searched axes, so a stage that depends on one searched axis depends on all.
    if axes.iter().any(|i| spec.searched.contains(i)) {
        axes.extend(spec.searched.clone());
    }
    axes.sort_unstable();
    axes.dedup();
    if faults.is_empty() { Ok(axes) } else { Err(faults) }
}

/// The searched axes that no stage mentions.
pub fn unused(spec: &Spec) -> Vec<&str> {
    let mut names = vec![];
    for stage in &spec.stages {
        stage.args.values().for_each(|given| mentions_in(&given.value, &mut names));
        names.extend(stage.predicate.iter().flat_map(|(text, _)| mentions(text)));
    }
    let searched = spec.search.iter().flat_map(|search| search.columns()).map(|(name, _)| name);
    searched.filter(|name| *name != TRIAL && !names.contains(name)).collect()
}

/// Axes of the spec that a value mentions, as positions.
pub fn axes_of(value: &Literal, spec: &Spec) -> Vec<usize> {
    let mut names = vec![];
    mentions_in(value, &mut names);
    known(names, spec)
}

/// Axes of the spec that a string mentions, as positions.
pub fn axes_in(text: &str, spec: &Spec) -> Vec<usize> {
    known(mentions(text), spec)
}

fn known(names: Vec<&str>, spec: &Spec) -> Vec<usize> {
    let mut axes: Vec<usize> = names.into_iter().filter_map(|n| spec.axis(n)).collect();
    axes.sort_unstable();
    axes.dedup();
    axes
}

/// Substitutes the axes in a value. `"$axis"` gives the axis value with its type; a reference inside a string inserts
/// the value as text.
pub fn put_in(value: &Literal, point: &SweepPoint) -> Literal {
    match value {
        Literal::Text(text) => match text.strip_prefix('$').and_then(|name| point.get(name)) {
            Some(value) => value.clone(),
            None => Literal::Text(spelt_in(text, point)),
        },
        Literal::List(items) => {
            let flat = |v: &Literal| match (v, put_in(v, point)) {
                // If a list mentions an axis whose value is a list, the entries of that value are added to the list.
                (Literal::Text(_), Literal::List(inner)) => inner,
                (_, one) => vec![one],
            };
            Literal::List(items.iter().flat_map(flat).collect())
        }
        Literal::Section(section) => {
            Literal::Section(SpecSection { keys: args_at(&section.keys, point), at: section.at.clone() })
        }
        other => other.clone(),
    }
}

/// The text with every reference to an axis replaced by the axis value.
pub fn spelt_in(text: &str, point: &SweepPoint) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(i) = rest.find('$') {
        out.push_str(&rest[..i]);
        rest = &rest[i + 1..];
        if let Some(after) = rest.strip_prefix('$') {
            out.push('$');
            rest = after;
            continue;
        }
        let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
        out.push_str(&point.get(&rest[..end]).map(spelt).unwrap_or_default());
        rest = &rest[end..];
    }
    out + rest
}

/// Text of a value inside a string; list entries are separated by commas.
fn spelt(value: &Literal) -> String {
    match value {
        Literal::List(items) => items.iter().map(Literal::to_string).collect::<Vec<_>>().join(","),
        one => one.to_string(),
    }
}

/// All arguments of a stage at one point.
pub fn args_at(args: &SpecEntries, point: &SweepPoint) -> SpecEntries {
    args.iter().map(|(k, g)| (k.clone(), SpecEntry { value: put_in(&g.value, point), ..g.clone() })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_axis_references_are_replaced_by_their_values() {
        let point: SweepPoint =
            [("lambda".to_owned(), Literal::Float(0.5)), ("line".to_owned(), Literal::Text("7".into()))].into();
        assert_eq!(put_in(&Literal::Text("$lambda".into()), &point), Literal::Float(0.5));
        assert_eq!(spelt_in("line = '$line' and $$x < $lambda", &point), "line = '7' and $x < 0.5");
        let lists: SweepPoint =
            [("tl".to_owned(), Literal::List(vec![Literal::Text("a".into()), Literal::Text("b".into())]))].into();
        let mentions_of = |names: &[&str]| Literal::List(names.iter().map(|n| Literal::Text((*n).into())).collect());
        assert_eq!(put_in(&Literal::Text("$tl".into()), &lists), mentions_of(&["a", "b"]));
        assert_eq!(put_in(&mentions_of(&["$tl", "c"]), &lists), mentions_of(&["a", "b", "c"]));
        assert_eq!(spelt_in("x in ($tl)", &lists), "x in (a,b)");
        assert_eq!(mentions("a $b and $$c $d_e."), ["b", "d_e"]);
    }
}
