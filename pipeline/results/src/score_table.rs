//! The scores as text that fits a terminal.

use schemas::metric::Metric;

use super::{
    scores::Scores,
    text::{columns, number},
};

/// Width of a table if the output is not a terminal.
pub const WIDTH: usize = 120;
/// Minimum width of a table.
const NARROWEST: usize = 80;
/// Maximum number of characters of an axis value in a table that would otherwise be too wide.
const AXIS_WIDTH: usize = 12;

/// The scores as text: at most `most` rows, each of at most `width` characters; widths below 80 are raised to 80. The
/// columns before the axes hold the signs: `*` for the best row of the leading metric, `!` for flagged rows, `~` for
/// in-sample rows. The last column holds the number of flagged lines. Single in-sample values are also marked with `~`.
/// A legend below explains the signs.
pub fn render(scores: &Scores, width: usize, most: usize) -> String {
    let width = width.max(NARROWEST);
    let best = scores.headline().filter(|_| scores.rows.len() > 1).and_then(|m| scores.best(m));
    let mut view =
        ScoreTableView { scores, best, most, axis_width: usize::MAX, metrics: (0..scores.metrics.len()).collect() };
    let mut left_out: Vec<&str> = vec![];
    let mut text = view.text();
    while widest(&text) > width {
        match view.least() {
            Some(at) => left_out.push(scores.metrics[view.metrics.remove(at)].name),
            None if view.axis_width > AXIS_WIDTH => view.axis_width = AXIS_WIDTH,
            None => break,
        }
        text = view.text();
    }
    text + &legend(scores, best, &left_out, most)
}

/// Scores selected for display.
struct ScoreTableView<'a> {
    scores: &'a Scores,
    best: Option<usize>,
    most: usize,
    axis_width: usize,
    metrics: Vec<usize>,
}

impl ScoreTableView<'_> {
    fn text(&self) -> String {
        let scores = self.scores;
        let named = |m: &usize| {
            let Metric { name, unit, .. } = scores.metrics[*m];
            if unit == "1" { (*name).to_owned() } else { format!("{name} [{unit}]") }
        };
        let in_sample = (0..scores.rows.len()).any(|r| scores.is_all_in_sample(r));
        let any_mark = self.best.is_some() || in_sample || scores.marks.iter().any(|n| *n > 0);
        let counted = scores.marks.iter().any(|n| *n > 0);
        let mut header: Vec<String> = if any_mark { vec![String::new()] } else { vec![] };
        header.extend(scores.axes.iter().map(|a| self.cut(a)));
        header.extend(self.metrics.iter().map(named));
        header.extend(counted.then(|| "flagged".to_owned()));
        let mut table = vec![header];
        for (row, (key, _)) in scores.rows.iter().enumerate().take(self.most) {
            let mut words: Vec<String> = if any_mark { vec![self.sign(row)] } else { vec![] };
            words.extend(key.iter().map(|k| self.cut(k)));
            words.extend(self.metrics.iter().map(|m| self.cell(row, *m)));
            let marks = scores.marks.get(row).copied().unwrap_or(0);
            words.extend(counted.then(|| if marks > 0 { format!("{marks}/{}", scores.lines) } else { "-".to_owned() }));
            table.push(words);
        }
        columns(&table, scores.axes.len() + usize::from(any_mark))
    }

    fn sign(&self, row: usize) -> String {
        let scores = self.scores;
        let mark = match scores.is_marked(row) {
            true if scores.is_cautious(row) => "c",
            true => "!",
            false if self.best == Some(row) => "*",
            false => "",
        };
        mark.to_owned() + if scores.is_all_in_sample(row) { "~" } else { "" }
    }

    /// Text of a value. An in-sample value is marked with `~` if the row also has values that are not in sample.
    fn cell(&self, row: usize, metric: usize) -> String {
        let scores = self.scores;
        let alone = scores.is_in_sample(row, metric) && !scores.is_all_in_sample(row);
        number(scores.value(row, metric)) + if alone { " ~" } else { "" }
    }

    fn cut(&self, word: &str) -> String {
        if word.chars().count() <= self.axis_width {
            return word.to_owned();
        }
        word.chars().take(self.axis_width.saturating_sub(2)).chain("..".chars()).collect()
    }

    /// The position of the metric to omit next; the leading metric is never omitted.
    fn least(&self) -> Option<usize> {
        let lead = self.scores.headline();
        let free = (0..self.metrics.len()).filter(|i| Some(self.metrics[*i]) != lead);
        // Among metrics of equal weight, the rightmost one is omitted first.
        free.min_by_key(|i| (self.scores.metrics[self.metrics[*i]].shown.weight, std::cmp::Reverse(*i)))
    }
}

fn widest(text: &str) -> usize {
    text.lines().map(|l| l.chars().count()).max().unwrap_or(0)
}

fn legend(scores: &Scores, best: Option<usize>, left_out: &[&str], most: usize) -> String {
    let mut out = String::new();
    if scores.rows.len() > most {
        out.push_str(&format!("and {} more points; `magline sql` shows all\n", scores.rows.len() - most));
    }
    let marked = scores.marks.iter().any(|n| *n > 0);
    let in_sample = scores.in_sample.iter().any(|row| row.metrics.contains(&true) || row.lines > 0);
    if let (Some(_), Some(metric)) = (best, scores.headline().and_then(|m| scores.metrics.get(m))) {
        let of = if marked { " of the points that are not flagged" } else { "" };
        out.push_str(&format!("* best {}{of}\n", metric.name));
    }
    let marked_rows = || (0..scores.rows.len()).filter(|r| scores.is_marked(*r));
    if marked_rows().any(|r| !scores.is_cautious(r)) {
        out.push_str(
            "! flagged: worse than the INS alone, NEES or NIS far from the expected value (2 and 1), or correlated \
             innovations (whiteness below 0.8 and correlated_nis above 1.5)\n",
        );
    }
    if marked_rows().any(|r| scores.is_cautious(r)) {
        out.push_str("c cautious: NEES or NIS far below the expected value (2 and 1); the covariance is too large\n");
    }
    if in_sample {
        out.push_str(&in_sample_legend(scores));
    }
    if !left_out.is_empty() {
        out.push_str(&format!("omitted to fit the width: {}; `magline sql` shows all\n", left_out.join(", ")));
    }
    out
}

/// The meaning of `~` and, if no point is the best, the reason.
fn in_sample_legend(scores: &Scores) -> String {
    let mut out =
        "~ in sample: the lines were used to make a model, noise estimate or map, or to choose a parameter; never \
         best\n"
            .to_owned();
    if scores.in_sample.iter().any(|row| row.lines > 0 && row.held_out > 0) {
        out.push_str(
            "values are of held-out lines; for in-sample lines see `value_in_sample` of the table `scores_pooled`\n",
        );
    }
    let in_sample = |r: usize, m: usize| scores.value(r, m).is_none() || scores.is_in_sample(r, m);
    let all = scores.headline().is_some_and(|m| (0..scores.rows.len()).all(|r| in_sample(r, m)));
    if all && scores.rows.len() > 1 {
        out.push_str("no best point: every line is in sample; use `where` to score lines that no fit uses\n");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::{InSampleScores, declared};

    fn scores(points: usize) -> Scores {
        let metrics = declared([
            "std_uncompensated",
            "std_error",
            "improvement_ratio",
            "improvement_ratio_band",
            "snr",
            "figure_of_merit_crossings",
            "ins_drms",
            "drms",
            "nees",
            "nis",
        ]);
        let row = |i: usize| (vec![format!("mag_{i}_uc"), "flux_a".to_owned()], vec![Some(1.0 + i as f64); 10]);
        Scores {
            axes: vec!["mag".to_owned(), "vector".to_owned()],
            metrics: metrics.to_vec(),
            rows: (0..points).map(row).collect(),
            lines: 9,
            marks: vec![0; points],
            cautious: vec![],
            in_sample: vec![],
        }
    }

    #[test]
    fn unit_values_in_sample_have_a_sign_and_are_never_the_best() {
        let mut some = scores(3);
        let of = |lines, held_out, metrics: Vec<bool>| InSampleScores {
            lines,
            held_out,
            values: vec![Some(7.0); 10],
            metrics,
        };
        // The first point has only in-sample lines, the second point has in-sample and held-out lines, and the third
        // point has one metric in sample.
        let mut one = vec![false; 10];
        one[5] = true;
        some.in_sample = vec![of(9, 0, vec![true; 10]), of(1, 8, vec![false; 10]), of(1, 8, one)];
        let text = render(&some, 200, 100);
        let rows: Vec<&str> = text.lines().collect();
        assert!(rows[1].starts_with("~  mag_0_uc") && rows[2].starts_with("*  mag_1_uc"), "{text}");
        assert!(rows[3].contains("3.000 ~") && rows[3].matches('~').count() == 1, "{text}");
        assert!(text.contains("\n~ in sample: the lines") && text.contains("\nvalues are of held-out lines"), "{text}");
        assert!(!text.contains("no best point"), "{text}");
        some.in_sample = vec![of(9, 0, vec![true; 10]); 3];
        let text = render(&some, 200, 100);
        assert!(!text.contains('*') && text.contains("\nno best point: every line is in sample"), "{text}");
        let mut single = scores(1);
        single.in_sample = vec![of(9, 0, vec![true; 10])];
        let text = render(&single, 200, 100);
        assert!(text.contains("\n~  mag_0_uc") && !text.contains("no best point"), "{text}");
    }

    #[test]
    fn user_the_table_fits_the_width_of_the_terminal() {
        for width in [80, 100, 120, 200] {
            let text = render(&scores(3), width, 100);
            let table = text.lines().take_while(|l| !l.starts_with('*'));
            assert!(table.clone().all(|l| l.chars().count() <= width), "{width}\n{text}");
            // The metrics of the track's quality are never omitted.
            for metric in ["drms [m]", "ins_drms [m]", "nees", "nis"] {
                assert!(table.clone().next().is_some_and(|l| l.contains(metric)), "{width}: no {metric}\n{text}");
            }
        }
        let narrow = render(&scores(3), 80, 100);
        assert!(narrow.contains("omitted to fit the width: std_uncompensated"), "{narrow}");
        assert!(!render(&scores(3), 200, 100).contains("omitted"));
    }

    #[test]
    fn unit_axis_values_are_shortened_last() {
        let mut wide = scores(2);
        wide.axes.extend(["features".to_owned(), "calibration".to_owned(), "window".to_owned()]);
        for (key, _) in &mut wide.rows {
            key.extend(["flux_a_x+flux_a_y+flux_a_z+cur_ac_lo".to_owned(), "a".repeat(40), "b".repeat(40)]);
        }
        let text = render(&wide, 80, 100);
        assert!(text.lines().take(3).all(|l| l.chars().count() <= 80) && text.contains("flux_a_x+f.."), "{text}");
    }

    #[test]
    fn user_the_best_row_and_flagged_rows_are_distinguished() {
        let mut some = scores(3);
        some.marks = vec![2, 0, 0];
        let text = render(&some, 120, 100);
        let rows: Vec<&str> = text.lines().collect();
        assert!(rows[1].starts_with("!  mag_0_uc") && rows[1].ends_with("2/9"), "{text}");
        assert!(rows[2].starts_with("*  mag_1_uc") && rows[2].ends_with('-'), "{text}");
        assert!(rows[3].starts_with("   mag_2_uc"), "{text}");
        assert!(text.contains("\n* best drms") && text.contains("\n! flagged: worse"), "{text}");
        some.marks = vec![1, 1, 1];
        assert!(!render(&some, 120, 100).contains('*'));
    }

    #[test]
    fn unit_one_point_without_a_mark_has_no_signs() {
        let text = render(&scores(1), 120, 100);
        assert!(text.starts_with("mag ") && !text.contains('*') && !text.contains('!'), "{text}");
    }
}
