//! Remedies for a flagged navigation, and the test of whether the trial of a remedy improved the line.
//!
//! A remedy changes keys of the stage `navigate`. It is suggested only if a trial on the flagged line improved the
//! result.

use schemas::Literal;
use stages::score::{Scorer, track};

use super::{LineFacts, LineMetrics, NavigationSettings, WarningKind, of_navigation};
use crate::text::number;

/// Keys of the assumed noise. Without these keys, the likelihood of the innovations determines the noise.
const NOISE_KEYS: [&str; 5] = ["tuning", "measurement_sigma_nt", "fogm_sigma_nt", "fogm_tau_s", "offset_window_s"];

/// Keys of the initial estimate. Without these keys, the columns of the flight determine the initial estimate.
const START_KEYS: [&str; 6] = [
    "start",
    "init_position_sigma_m",
    "init_altitude_sigma_m",
    "init_velocity_sigma_mps",
    "init_attitude_sigma_deg",
    "init_heading_sigma_deg",
];

/// Two accuracies count as equal if the ratio of the DRMS with a remedy to the DRMS without it is at most this.
const EQUAL_DRMS: f64 = 1.05;

/// A remedy that does not remove the flag is an improvement if the ratio of the DRMS with the remedy to the DRMS
/// without it is at most this.
const BETTER_DRMS: f64 = 0.8;

/// Change of the keys of a navigation that may remove a warning.
#[derive(Clone, Debug, PartialEq)]
pub struct Remedy {
    /// Subject of the change.
    pub subject: &'static str,
    /// The keys with their new values; `None` removes a key.
    pub changes: Vec<(&'static str, Option<Literal>)>,
}

impl Remedy {
    fn set(subject: &'static str, key: &'static str, value: Literal) -> Remedy {
        Remedy { subject, changes: vec![(key, Some(value))] }
    }

    /// Removal of the keys among `keys` that are set; `None` if none is set.
    fn removal(subject: &'static str, keys: &[&'static str], is_set: &dyn Fn(&str) -> bool) -> Option<Remedy> {
        let changes: Vec<_> = keys.iter().filter(|key| is_set(key)).map(|key| (*key, None)).collect();
        (!changes.is_empty()).then_some(Remedy { subject, changes })
    }

    /// The change as text, such as `` without `fogm_tau_s` ``.
    pub fn text(&self) -> String {
        let one = |(key, value): &(&str, Option<Literal>)| match value {
            Some(Literal::Text(text)) => format!("`{key} = \"{text}\"`"),
            Some(value) => format!("`{key} = {value}`"),
            None => format!("`{key}`"),
        };
        let removes = self.changes.iter().all(|(_, value)| value.is_none());
        let listed: Vec<String> = self.changes.iter().map(one).collect();
        format!("{} {}", if removes { "without" } else { "with" }, listed.join(", "))
    }
}

/// Remedies that may remove a warning of a line, in the order of their trials. `is_set` returns whether the spec sets a
/// key of the navigation.
pub fn remedies(kind: WarningKind, facts: &LineFacts, is_set: &dyn Fn(&str) -> bool) -> Vec<Remedy> {
    let Some(settings) = &facts.settings else { return vec![] };
    let filter = |name: &str| Literal::Text(name.to_owned());
    let wide = || facts.wide_start_m().map(|_| Remedy::set("the wide start", "filter", filter("mpf_then_ekf")));
    // An extended filter that converged to a wrong position treats valid measurements as outliers.
    let nonlinear =
        |name: &str| settings.start_m.map(|_| Remedy::set("the linearisation of the map", "filter", filter(name)));
    let date = || {
        let removal = Remedy::removal("the date of the core field", &["decimal_year"], is_set);
        removal.filter(|_| settings.wrong_date().is_some())
    };
    let levels = || {
        let removal = Remedy::removal("the height of the map", &["map_levels_m"], is_set);
        removal.filter(|_| facts.map_height_nt().is_some())
    };
    let noise = || Remedy::removal("the assumed noise", &NOISE_KEYS, is_set);
    let start = || Remedy::removal("the assumed initial uncertainty", &START_KEYS, is_set);
    let all: Vec<Option<Remedy>> = match kind {
        WarningKind::WorseThanIns
        | WarningKind::NeesHigh
        | WarningKind::NisHigh
        | WarningKind::NotWhite
        | WarningKind::Gated => {
            let nonlinear = ["mpf_then_ekf", "ukf"].map(nonlinear);
            [wide(), date(), levels(), noise(), start()].into_iter().chain(nonlinear).collect()
        }
        WarningKind::NeesLow | WarningKind::NisLow => vec![noise(), start()],
        WarningKind::WideStart => vec![wide(), start()],
        WarningKind::MapHeight => vec![levels()],
        WarningKind::Gnss => {
            vec![start(), Some(Remedy::set("the test of GNSS positions", "gnss_test", Literal::Bool(false)))]
        }
        WarningKind::Late
        | WarningKind::HeightBias
        | WarningKind::OffMap
        | WarningKind::Flat
        | WarningKind::Retention
        | WarningKind::Fit
        | WarningKind::Map
        | WarningKind::Stage
        | WarningKind::Metric => vec![],
    };
    let mut found: Vec<Remedy> = vec![];
    for remedy in all.into_iter().flatten() {
        if found.iter().all(|other| other.changes != remedy.changes) {
            found.push(remedy);
        }
    }
    found
}

/// Result of a trial that improved a flagged line.
#[derive(Clone, Debug, PartialEq)]
pub struct Improvement {
    /// Figures of the trial as text, compared with the figures before it.
    pub figures: String,
    /// Whether the line is still flagged.
    pub is_flagged: bool,
}

/// Compares the scores of a flagged line without and with a remedy; `None` if the remedy does not improve them.
///
/// If the true position is known, either the flag must vanish and the DRMS must not grow, or the DRMS must shrink by at
/// least 20 % and the NEES must not move away from 2. If the true position is unknown, the flag must vanish. No new
/// flag may appear.
pub fn improvement(kind: WarningKind, before: &LineMetrics, after: &LineMetrics) -> Option<Improvement> {
    let flags = |row: &LineMetrics| -> Vec<WarningKind> {
        of_navigation(row, NavigationSettings::default()).into_iter().map(|w| w.kind).filter(|k| k.spoils()).collect()
    };
    let (old, new) = (flags(before), flags(after));
    if new.iter().any(|kind| !old.contains(kind)) {
        return None;
    }
    let expected = track::NEES.metric.target()?;
    let vanishes = old.contains(&kind) && !new.contains(&kind);
    let both = |metric: &Scorer| before.get(metric).zip(after.get(metric));
    let improves = match (both(&track::DRMS), both(&track::NEES)) {
        (Some((old_m, new_m)), Some((old_nees, new_nees))) => {
            let misfit = |nees: f64| (nees / expected).ln().abs();
            let is_better = new_m <= BETTER_DRMS * old_m && misfit(new_nees) <= misfit(old_nees);
            is_better || vanishes && new_m <= EQUAL_DRMS * old_m
        }
        _ => vanishes,
    };
    let metrics = match both(&track::DRMS) {
        Some(_) => [(&track::DRMS, " m"), (&track::NEES, "")],
        None => [(&track::NIS, ""), (&track::CORRELATED_NIS, "")],
    };
    let figure = |(scorer, unit): &(&Scorer, &str)| {
        let (old, new) = both(scorer)?;
        let [old, new] = [old, new].map(|value| number(Some(value)));
        Some(format!("{} {new}{unit} instead of {old}{unit}", scorer.metric.name))
    };
    let figures: Vec<String> = metrics.iter().filter_map(figure).collect();
    let improvement = || Improvement { figures: figures.join(", "), is_flagged: !new.is_empty() };
    (improves && !figures.is_empty()).then(improvement)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(drms: f64, nees: f64, nis: f64) -> LineMetrics {
        LineMetrics::from([("drms", drms), ("ins_drms", 900.0), ("nees", nees), ("nis", nis)])
    }

    #[test]
    fn unit_remedies_remove_only_keys_that_are_set() {
        let is_set = |key: &str| ["measurement_sigma_nt", "offset_window_s", "init_position_sigma_m"].contains(&key);
        let row = row(90.0, 90.0, 9.0);
        let texts = |kind: WarningKind, settings: NavigationSettings, is_set: &dyn Fn(&str) -> bool| -> Vec<String> {
            let facts = LineFacts { row: &row, settings: Some(settings) };
            remedies(kind, &facts, is_set).iter().map(Remedy::text).collect()
        };
        let given = || NavigationSettings { sigma_nt: Some(0.001), ..NavigationSettings::default() };
        let found = texts(WarningKind::NeesHigh, given(), &is_set);
        assert_eq!(found, ["without `measurement_sigma_nt`, `offset_window_s`", "without `init_position_sigma_m`"]);
        // There is no remedy if no key is set, or if no key explains the warning.
        let auto = || NavigationSettings { found: true, ..given() };
        assert!(texts(WarningKind::NeesHigh, auto(), &|_| false).is_empty());
        assert!(texts(WarningKind::Retention, given(), &is_set).is_empty());
        let wide = NavigationSettings { start_m: Some((1500.0, 285.0)), ..auto() };
        assert_eq!(texts(WarningKind::WideStart, wide.clone(), &|_| false), ["with `filter = \"mpf_then_ekf\"`"]);
        // A filter that linearises the map has two remedies: two filters that do not linearise it. The same change is
        // listed only once.
        let filters = ["with `filter = \"mpf_then_ekf\"`", "with `filter = \"ukf\"`"];
        assert_eq!(texts(WarningKind::Gated, wide, &|_| false), filters);
    }

    #[test]
    fn unit_a_trial_improves_only_if_the_flag_vanishes_or_the_error_is_smaller() {
        let before = row(45.6, 35.0, 1.0);
        let found = |after: LineMetrics| improvement(WarningKind::NeesHigh, &before, &after);
        let figures = "drms 13.10 m instead of 45.60 m, nees 1.400 instead of 35.00".to_owned();
        assert_eq!(found(row(13.1, 1.4, 1.0)), Some(Improvement { figures, is_flagged: false }));
        assert!(found(row(30.0, 30.0, 1.0)).is_some_and(|improvement| improvement.is_flagged));
        // Cases: a larger error, a NEES that is farther from 2, a new flag, and no change.
        for after in [row(60.0, 2.0, 1.0), row(20.0, 50.0, 1.0), row(13.1, 1.4, 9.0), before.clone()] {
            assert_eq!(found(after.clone()), None, "{after:?}");
        }
    }

    #[test]
    fn unit_without_truth_the_flag_of_the_innovations_decides() {
        let nis = |nis: f64| LineMetrics::from([("nis", nis)]);
        let found = improvement(WarningKind::NisHigh, &nis(9.0), &nis(1.1));
        assert!(found.is_some_and(|improvement| improvement.figures == "nis 1.100 instead of 9.000"));
        assert_eq!(improvement(WarningKind::NisHigh, &nis(9.0), &nis(5.0)), None);
        // The innovations do not show whether another start or filter is better.
        assert_eq!(improvement(WarningKind::WideStart, &nis(1.0), &nis(1.0)), None);
    }
}
