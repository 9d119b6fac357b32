//! The scores as text that fits a terminal.

use schemas::metric::Metric;

use super::{
    scores::Scores,
    text::{columns, number},
};

/// The width of a table where there is no terminal.
pub const WIDTH: usize = 120;
/// No table is made narrower than this.
const NARROWEST: usize = 80;
/// The most characters of an axis value where the table would be too wide otherwise.
const AXIS_WIDTH: usize = 12;

/// The scores as text: at most `most` rows of at most `width` characters (80 at least). The columns before the axes
/// mark the best row of the leading metric with `*` and the rows that are not to be trusted with `!`; the last column
/// says on how many of the lines. What is left out and what the marks mean is said below.
pub fn render(scores: &Scores, width: usize, most: usize) -> String {
    let width = width.max(NARROWEST);
    let best = scores.headline().filter(|_| scores.rows.len() > 1).and_then(|m| scores.best(m));
    let mut view = View { scores, best, most, axis_width: usize::MAX, metrics: (0..scores.metrics.len()).collect() };
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

/// What of the scores is shown.
struct View<'a> {
    scores: &'a Scores,
    best: Option<usize>,
    most: usize,
    axis_width: usize,
    metrics: Vec<usize>,
}

impl View<'_> {
    fn text(&self) -> String {
        let scores = self.scores;
        let named = |m: &usize| {
            let Metric { name, unit, .. } = scores.metrics[*m];
            if unit == "1" { (*name).to_owned() } else { format!("{name} [{unit}]") }
        };
        let any_mark = self.best.is_some() || scores.marks.iter().any(|n| *n > 0);
        let counted = scores.marks.iter().any(|n| *n > 0);
        let mut header: Vec<String> = if any_mark { vec![String::new()] } else { vec![] };
        header.extend(scores.axes.iter().map(|a| self.cut(a)));
        header.extend(self.metrics.iter().map(named));
        header.extend(counted.then(|| "marked".to_owned()));
        let mut table = vec![header];
        for (row, (key, _)) in scores.rows.iter().enumerate().take(self.most) {
            let mut words: Vec<String> = if any_mark { vec![self.sign(row).to_owned()] } else { vec![] };
            words.extend(key.iter().map(|k| self.cut(k)));
            words.extend(self.metrics.iter().map(|m| number(scores.value(row, *m))));
            let marks = scores.marks.get(row).copied().unwrap_or(0);
            words.extend(counted.then(|| if marks > 0 { format!("{marks}/{}", scores.lines) } else { "-".to_owned() }));
            table.push(words);
        }
        columns(&table, scores.axes.len() + usize::from(any_mark))
    }

    fn sign(&self, row: usize) -> &'static str {
        match (self.best == Some(row), self.scores.is_marked(row)) {
            (_, true) => "!",
            (true, false) => "*",
            (false, false) => "",
        }
    }

    fn cut(&self, word: &str) -> String {
        if word.chars().count() <= self.axis_width {
            return word.to_owned();
        }
        word.chars().take(self.axis_width.saturating_sub(2)).chain("..".chars()).collect()
    }

    /// The place of the metric that gives way next; the leading one stays.
    fn least(&self) -> Option<usize> {
        let lead = self.scores.headline();
        let free = (0..self.metrics.len()).filter(|i| Some(self.metrics[*i]) != lead);
        // Of two of one weight the one further right goes first.
        free.min_by_key(|i| (self.scores.metrics[self.metrics[*i]].shown.weight, std::cmp::Reverse(*i)))
    }
}

fn widest(text: &str) -> usize {
    text.lines().map(|l| l.chars().count()).max().unwrap_or(0)
}

fn legend(scores: &Scores, best: Option<usize>, left_out: &[&str], most: usize) -> String {
    let mut out = String::new();
    if scores.rows.len() > most {
        out.push_str(&format!("and {} more points; `magline sql` shows them all\n", scores.rows.len() - most));
    }
    if let (Some(_), Some(metric)) = (best, scores.headline().and_then(|m| scores.metrics.get(m))) {
        let of = if scores.marks.iter().any(|n| *n > 0) { " of the points without a mark" } else { "" };
        out.push_str(&format!("* best {}{of}\n", metric.name));
    }
    if scores.marks.iter().any(|n| *n > 0) {
        out.push_str("! marked: worse than the INS alone, or NEES or NIS far from its law (2 and 1)\n");
    }
    if !left_out.is_empty() {
        out.push_str(&format!("left out for width: {}; `magline sql` shows all\n", left_out.join(", ")));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::scores::declared;

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
        }
    }

    #[test]
    fn r10_the_table_fits_whatever_the_terminal() {
        for width in [80, 100, 120, 200] {
            let text = render(&scores(3), width, 100);
            let table = text.lines().take_while(|l| !l.starts_with('*'));
            assert!(table.clone().all(|l| l.chars().count() <= width), "{width}\n{text}");
            // The figures that say whether the track is any good stay.
            for metric in ["drms [m]", "ins_drms [m]", "nees", "nis"] {
                assert!(table.clone().next().is_some_and(|l| l.contains(metric)), "{width}: no {metric}\n{text}");
            }
        }
        let narrow = render(&scores(3), 80, 100);
        assert!(narrow.contains("left out for width: std_uncompensated"), "{narrow}");
        assert!(!render(&scores(3), 200, 100).contains("left out"));
    }

    #[test]
    fn r10_a_wide_sweep_is_cut_in_its_axes_last() {
        let mut wide = scores(2);
        wide.axes.extend(["features".to_owned(), "calibration".to_owned(), "window".to_owned()]);
        for (key, _) in &mut wide.rows {
            key.extend(["flux_a_x+flux_a_y+flux_a_z+cur_ac_lo".to_owned(), "a".repeat(40), "b".repeat(40)]);
        }
        let text = render(&wide, 80, 100);
        assert!(text.lines().take(3).all(|l| l.chars().count() <= 80) && text.contains("flux_a_x+f.."), "{text}");
    }

    #[test]
    fn r10_the_best_row_and_the_marked_ones_are_told_apart() {
        let mut some = scores(3);
        some.marks = vec![2, 0, 0];
        let text = render(&some, 120, 100);
        let rows: Vec<&str> = text.lines().collect();
        assert!(rows[1].starts_with("!  mag_0_uc") && rows[1].ends_with("2/9"), "{text}");
        assert!(rows[2].starts_with("*  mag_1_uc") && rows[2].ends_with('-'), "{text}");
        assert!(rows[3].starts_with("   mag_2_uc"), "{text}");
        assert!(text.contains("\n* best drms") && text.contains("\n! marked: worse"), "{text}");
        some.marks = vec![1, 1, 1];
        assert!(!render(&some, 120, 100).contains('*'));
    }

    #[test]
    fn unit_one_point_without_a_mark_has_no_signs() {
        let text = render(&scores(1), 120, 100);
        assert!(text.starts_with("mag ") && !text.contains('*') && !text.contains('!'), "{text}");
    }
}
