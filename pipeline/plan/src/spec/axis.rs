//! The axes of a sweep: their values, listed one by one or as the subsets of a list.

use schemas::{Fault, Literal};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::literal;

/// Maximum number of values; more are probably a mistake.
const MOST_VALUES: u128 = 100_000;
/// Maximum total number of entries over all subsets of an axis.
const MOST_ENTRIES: u128 = 5_000_000;
const SUBSET_KEYS: [&str; 3] = ["subsets_of", "at_least", "up_to"];

/// The values of the axis `name`: a list, one value, or `{ subsets_of = [...], at_least = 1, up_to = 2 }`.
///
/// A value may itself be a list of strings or numbers. `"$axis"` is then replaced by that list where a parameter takes
/// one, or by its entries inside another list: `features = ["$terms", "mag_3_uc"]`. The key column of the axis then
/// holds text: the entries joined by `+`. `subsets_of` makes all lists of `at_least` to `up_to` of its entries, the
/// shorter lists first, each with its entries in the given order. An entry that is a list is included or omitted as a
/// whole.
///
/// # Errors
/// Fails with the faults of the values, each with its position.
pub fn values(name: &str, value: &Spanned<DeValue>) -> Result<Vec<Literal>, Vec<Fault>> {
    let (values, places) = match value.get_ref() {
        DeValue::Table(table) => {
            let subsets = subsets(name, table, value.span())?;
            let places = vec![value.span(); subsets.len()];
            (subsets, places)
        }
        DeValue::Array(items) => {
            let each: Vec<_> = items.iter().map(|v| one(name, v).map(|x| (x, v.span()))).collect();
            let faults: Vec<Fault> = each.iter().filter_map(|r| r.as_ref().err().cloned()).collect();
            if !faults.is_empty() {
                return Err(faults);
            }
            each.into_iter().flatten().unzip()
        }
        _ => (vec![one(name, value).map_err(|f| vec![f])?], vec![value.span()]),
    };
    let wrong = |what: String, at: std::ops::Range<usize>| Err(vec![Fault::new(what).at(at)]);
    if values.is_empty() {
        return wrong(format!("the axis `{name}` has no values"), value.span());
    }
    if let Some((i, what)) = mixed(&values) {
        let fault = Fault::new(format!("the axis `{name}` {what}")).at(places[i].clone());
        let lists = values.iter().any(|v| matches!(v, Literal::List(_)));
        return Err(vec![if lists { fault.help("write a single entry as a list too: `[\"tl\"]`") } else { fault }]);
    }
    let values = one_type(values);
    let mut seen = std::collections::HashSet::new();
    match values.iter().position(|v| !seen.insert(v.to_string())) {
        Some(i) => wrong(format!("the axis `{name}` has the value `{}` twice", values[i]), places[i].clone()),
        None => Ok(values),
    }
}

/// One value of an axis. A list must not contain lists.
fn one(name: &str, value: &Spanned<DeValue>) -> Result<Literal, Fault> {
    let found = literal(value)?;
    let Some(items) = value.get_ref().as_array() else { return Ok(found) };
    let deeper = items.iter().find(|v| v.get_ref().is_array());
    match deeper {
        Some(v) => Err(Fault::new(format!("a value of the axis `{name}` cannot contain a list of lists")).at(v.span())),
        None => Ok(found),
    }
}

/// Index of the first value whose type differs from the type of `values[0]`, and the message of the fault.
fn mixed(values: &[Literal]) -> Option<(usize, String)> {
    let number = |v: &Literal| matches!(v, Literal::Int(_) | Literal::Float(_));
    let same = |v: &Literal| v.type_name() == values[0].type_name() || number(v) && number(&values[0]);
    let i = values.iter().position(|v| !same(v))?;
    Some((i, format!("mixes a {} with a {}", values[0].type_name(), values[i].type_name())))
}

/// Converts integers to floating-point numbers in a list that contains floating-point numbers.
fn one_type(values: Vec<Literal>) -> Vec<Literal> {
    if !values.iter().any(|v| matches!(v, Literal::Float(_))) {
        return values;
    }
    let float = |v: Literal| if let Literal::Int(n) = v { Literal::Float(n as f64) } else { v };
    values.into_iter().map(float).collect()
}

fn subsets(name: &str, table: &DeTable, at: std::ops::Range<usize>) -> Result<Vec<Literal>, Vec<Fault>> {
    let mut faults = vec![];
    for (key, _) in table.iter().filter(|(k, _)| !SUBSET_KEYS.contains(&k.get_ref().as_ref())) {
        let fault = Fault::new(format!("the axis `{name}` has no key `{}`", key.get_ref()));
        faults.push(fault.nearest(key.get_ref(), &SUBSET_KEYS).at(key.span()));
    }
    let entries = match table.get("subsets_of").map(|v| (v, v.get_ref().as_array())) {
        Some((v, Some(items))) if items.is_empty() => {
            Err(Fault::new(format!("`subsets_of` of the axis `{name}` is empty")).at(v.span()))
        }
        Some((_, Some(items))) => items.iter().map(|v| one(name, v)).collect::<Result<Vec<Literal>, Fault>>(),
        Some((v, None)) => Err(Fault::new("`subsets_of` must be a list").at(v.span())),
        None => Err(Fault::new(format!("the axis `{name}` requires `subsets_of`, a list")).at(at.clone())),
    };
    let entries = entries.map_err(|f| faults.push(f)).unwrap_or_default();
    let n = entries.len();
    let mut count = |key: &str, default: usize| match table.get(key) {
        None => default,
        Some(v) => match literal(v) {
            Ok(Literal::Int(k)) if k >= 0 && (n == 0 || k.unsigned_abs() <= n as u64) => k.unsigned_abs() as usize,
            _ => {
                faults.push(Fault::new(format!("`{key}` must be a whole number from 0 to {n}")).at(v.span()));
                default
            }
        },
    };
    let (least, most) = (count("at_least", 1), count("up_to", n));
    if faults.is_empty() && least > most {
        faults.push(Fault::new(format!("`at_least` is {least}, but `up_to` is only {most}")).at(at.clone()));
    }
    if faults.is_empty() {
        let of = |k: usize| binomial(n as u128, k as u128);
        let sum = |each: &dyn Fn(usize) -> u128| {
            (least..=most).try_fold(0, |all, k| below(u128::saturating_add(all, each(k))))
        };
        let (many, entries) = (sum(&of), sum(&|k| (k as u128).saturating_mul(of(k))));
        if many.is_none_or(|m| m > MOST_VALUES) || entries.is_none_or(|e| e > MOST_ENTRIES) {
            let number = many.map_or("more than 10^30".to_owned(), |m| m.to_string());
            let fault = Fault::new(format!(
                "the axis `{name}` would have {number} values, one for each permitted subset of its {n} entries"
            ))
            .at(at);
            let help = format!(
                "at most {MOST_VALUES} values with {MOST_ENTRIES} entries in total are permitted: use a smaller \
                 `up_to`"
            );
            faults.push(fault.help(help));
        }
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    let chosen = (least..=most).flat_map(|k| choices(n, k));
    Ok(chosen.map(|places| Literal::List(places.iter().flat_map(|&i| flat(&entries[i])).collect())).collect())
}

fn flat(entry: &Literal) -> Vec<Literal> {
    match entry {
        Literal::List(items) => items.clone(),
        one => vec![one.clone()],
    }
}

/// Returns `n`; `None` above 10^30, so that products do not overflow.
fn below(n: u128) -> Option<u128> {
    (n <= 10u128.pow(30)).then_some(n)
}

/// Number of subsets with `k` of `n` entries; if it exceeds 10^30, an arbitrary larger number.
fn binomial(n: u128, k: u128) -> u128 {
    let step = |b: u128, i: u128| below(b).map(|b| b * (n - i) / (i + 1));
    (0..k.min(n - k)).try_fold(1, step).unwrap_or(u128::MAX / 2)
}

/// All increasing lists of `k` of the numbers below `n`, in lexicographic order.
fn choices(n: usize, k: usize) -> impl Iterator<Item = Vec<usize>> {
    let next = move |now: &Vec<usize>| {
        let at = (0..k).rev().find(|i| now[*i] < n - k + i)?;
        let mut next = now.clone();
        next[at] += 1;
        (at + 1..k).for_each(|i| next[i] = next[i - 1] + 1);
        Some(next)
    };
    std::iter::successors((k <= n).then(|| (0..k).collect()), next)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn texts(toml: &str) -> Vec<String> {
        let value = DeValue::parse(toml).unwrap();
        values("mags", &value).unwrap().iter().map(Literal::to_string).collect()
    }

    fn fault(toml: &str) -> (String, String) {
        let value = DeValue::parse(toml).unwrap();
        let fault = values("mags", &value).unwrap_err().remove(0);
        (fault.what, toml[fault.at.unwrap()].to_owned())
    }

    #[test]
    fn unit_subsets_are_counted_by_binomials_and_ordered() {
        assert_eq!(texts("{ subsets_of = ['a', 'b', 'c'], up_to = 2 }"), ["a", "b", "c", "a+b", "a+c", "b+c"]);
        assert_eq!(texts("{ subsets_of = [['a', 'a_dot'], 'b'], at_least = 0 }"), ["", "a+a_dot", "b", "a+a_dot+b"]);
        assert_eq!(texts("{ subsets_of = [1, 2, 3, 4, 5, 6], at_least = 3, up_to = 3 }").len(), 20);
        assert_eq!((0..=6).map(|k| binomial(6, k)).collect::<Vec<_>>(), [1, 6, 15, 20, 15, 6, 1]);
        assert_eq!((0..=9).map(|k| choices(9, k).count() as u128).sum::<u128>(), 512);
        assert_eq!(choices(4, 2).collect::<Vec<_>>(), [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]);
    }

    #[test]
    fn unit_subsets_are_counted_before_they_are_made() {
        let names = |n: usize| (0..n).map(|i| format!("'x{i}'")).collect::<Vec<_>>().join(", ");
        for (n, rest, expected_text) in [
            (30, "", "1073741823 values"),
            (30, ", at_least = 10, up_to = 12", "171165540 values"),
            (200, "", "more than 10^30 values"),
            (5000, ", at_least = 2500", "more than 10^30 values"),
            (5000, ", at_least = 4999", "5001 values"),
        ] {
            let toml = format!("{{ subsets_of = [{}]{rest} }}", names(n));
            let value = DeValue::parse(&toml).unwrap();
            let fault = values("mags", &value).unwrap_err().remove(0);
            assert!(fault.what.contains(expected_text) && fault.help.unwrap().contains("`up_to`"), "{}", fault.what);
        }
        // Few subsets have 28 or more of 30 entries, but more than a hundred million have half of the entries.
        assert_eq!(texts(&format!("{{ subsets_of = [{}], at_least = 28 }}", names(30))).len(), 435 + 30 + 1);
    }

    #[test]
    fn unit_lists_are_values() {
        assert_eq!(texts("[['tl'], ['tl', 'mag_3_uc']]"), ["tl", "tl+mag_3_uc"]);
        assert_eq!(texts("'one'"), ["one"]);
        assert_eq!(texts("[1, 0.5]"), ["1", "0.5"]);
    }

    #[test]
    fn gold_faults_have_the_position_of_the_value() {
        let assert_fault = |toml, what: &str, at: &str| assert_eq!(fault(toml), (what.to_owned(), at.to_owned()));
        assert_fault("['tl', ['tl', 'x']]", "the axis `mags` mixes a text with a list", "['tl', 'x']");
        assert_fault("[['a', 'b'], ['a+b']]", "the axis `mags` has the value `a+b` twice", "['a+b']");
        assert_fault("[['a', ['b']]]", "a value of the axis `mags` cannot contain a list of lists", "['b']");
        assert_fault("{ subset_of = ['a'] }", "the axis `mags` has no key `subset_of`", "subset_of");
        assert_fault("{ subsets_of = ['a'], up_to = 2 }", "`up_to` must be a whole number from 0 to 1", "2");
        assert_fault("{ subsets_of = 'a' }", "`subsets_of` must be a list", "'a'");
        assert_fault("{ subsets_of = [] }", "`subsets_of` of the axis `mags` is empty", "[]");
        assert_fault("[]", "the axis `mags` has no values", "[]");
    }
}
