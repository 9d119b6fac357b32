//! The text of a spec, with the reason for each choice.

use std::sync::Arc;

use intake::mapping::Mapping;
use results::text::number;

use super::findings::{LineFinding, LogFindings, TableFindings};

/// Mapping of a log.
pub struct InitSource {
    /// The name of a built-in mapping.
    pub builtin: Option<&'static str>,
    /// The mapping.
    pub mapping: Option<Arc<Mapping>>,
    /// The text of a mapping for this log, which is written next to the spec.
    pub own: Option<String>,
}

/// Contents of a spec.
pub struct InitText<'a> {
    pub name: String,
    /// The path of the log in the spec.
    pub log: String,
    /// The file of the log's own mapping.
    pub mapping: Option<String>,
    pub source: &'a InitSource,
    pub found: &'a LogFindings,
    /// The path of the map in the spec.
    pub map: Option<String>,
    pub questions: Vec<String>,
}

/// Change of direction of the vector magnetometer above which a line has manoeuvres, degrees.
const MANOEUVRE_DEG: f64 = 1.0;
/// Minimum number of samples of a calibration line: the ends are trimmed, and 18 terms are fitted.
const CALIBRATION_ROWS: usize = 200;

/// A text as a TOML string.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

impl InitText<'_> {
    /// The table with a scalar magnetometer, else with a vector magnetometer, else the first.
    fn main(&self) -> Option<&TableFindings> {
        let all = &self.found.tables;
        let scalar = all.iter().find(|t| !t.scalars.is_empty());
        scalar.or_else(|| all.iter().find(|t| !t.vectors.is_empty())).or_else(|| all.first())
    }

    /// The calibration line: the line whose vector magnetometer turns most.
    fn calibration<'a>(&self, table: &'a TableFindings) -> Option<(&'a (String, String), &'a LineFinding)> {
        let long = table.lines.iter().filter(|(_, l)| l.rows >= CALIBRATION_ROWS);
        let swung = long.filter(|(_, l)| l.swing_deg.is_some_and(|x| x >= MANOEUVRE_DEG));
        swung.max_by(|(_, a), (_, b)| a.swing_deg.unwrap_or(0.0).total_cmp(&b.swing_deg.unwrap_or(0.0)))
    }

    /// The text of the spec.
    pub fn text(&self) -> String {
        let mut text = format!(
            "# Written by `magline init`. It runs as it is: magline run SPEC. Lines with `?` need your answer.\n\n\
             name  = {}\nstore = \"store\"   # folder of the results\n",
            quoted(&self.name)
        );
        for question in &self.questions {
            text += &format!("# ? {}\n", question.escape_debug());
        }
        let Some(main) = self.main() else { return text };
        text += "\n[tables.log]\n";
        text += &format!("path    = {}\n", quoted(&self.log));
        match (&self.mapping, self.source.builtin) {
            (Some(own), _) => {
                text +=
                    &format!("mapping = {}   # columns, units, axes and time; check each `guess` in it\n", quoted(own));
            }
            (None, Some(name)) => {
                text += &format!("mapping = {}   # chosen by the topics and columns of the log\n", quoted(name));
            }
            (None, None) => text += "# No mapping: the columns have the names of the flight table.\n",
        }
        if !main.name.is_empty() {
            text += &format!("table   = {}\n", quoted(&main.name));
        }
        for (key, given) in [("flight ", &self.found.flight), ("line   ", &self.found.line)] {
            if let Some(given) = given {
                text += &format!("{key} = {}   # the log has no such column\n", quoted(given));
            }
        }
        let date = if main.has("year") {
            ""
        } else {
            "# ? No date was found, so `core_field` and `navigate` are not possible. Give it as `date` in `time` of a \
             mapping.\n"
        };
        text += date;
        if let Some(map) = &self.map {
            text += &format!("\n[tables.anomaly]\npath = {}\n", quoted(map));
        }
        text + &self.stages(main)
    }

    fn stages(&self, main: &TableFindings) -> String {
        let rate = main.rate_hz().map_or(10.0, rounded);
        let mut text = format!(
            "\n# Even times, at the sampling rate of the magnetometer: nothing is aliased.\n[[stages]]\nname    = \
             \"even\"\nstage   = \"resample\"\ninput   = \"log\"\nrate_hz = {rate:?}\n"
        );
        if rate <= 2.0 {
            text += &format!("max_gap_s = {:?}   # 2.5 samples\n", 2.5 / rate);
        }
        let mut last = "even";
        let Some(mag) = main.scalars.first() else {
            text += "# ? No scalar magnetometer was found. Classical compensation requires one.\n";
            if let Some(vector) = main.vectors.first() {
                text += &format!(
                    "\n# The magnitude of the vector magnetometer. Tolles-Lawson terms of the same sensor cannot \
                     compensate it.\n[[stages]]\nname   = \"total\"\nstage  = \"magnitude\"\ninput  = \"even\"\nvector \
                     = {}\n",
                    quoted(vector)
                );
            }
            return text;
        };
        text += &listed("scalar magnetometers", &main.scalars);
        text += &listed("vector magnetometers", &main.vectors);
        let calibration = self.calibration(main);
        if let (Some(vector), Some(((flight, line), found))) = (main.vectors.first(), calibration) {
            let sql = |x: &str| x.replace('\'', "''");
            let condition = format!("flight = '{}' and line = '{}'", sql(flight), sql(line));
            let (low, high) = (0.1_f64.min(0.05 * rate), 0.9_f64.min(0.45 * rate));
            text += &format!(
                "\n[[stages]]\nname   = \"terms\"\nstage  = \"a_matrix\"\ninput  = \"even\"\nvector = {}\n\n\
                 # Calibration on the line with the strongest manoeuvres: the field direction changes by {} deg.\n\
                 # If another line is your calibration figure, change `where`. Without `where`, all lines are used.\n\
                 [[stages]]\nname    = \"coefficients\"\nstage   = \"fit\"\ninput   = \"terms\"\nwhere   = {}\n\
                 model   = \"tolles_lawson\"\ntarget  = {}\nlow_hz  = {low:?}\nhigh_hz = {high:?}   # below half of \
                 the sampling rate\n\n[[stages]]\nname  = \"clean\"\nstage = \"compensate\"\ninput = \"terms\"\n\
                 model = \"coefficients\"\nmag   = {}\n\n\
                 # There is no truth, so the ratios include the anomaly. The calibration line is `in_sample`.\n\
                 [[stages]]\nname    = \"scores\"\nstage   = \"score\"\ninput   = [\"clean\"]\nmetrics = \
                 [\"std_uncompensated\", \"improvement_ratio\", \"improvement_ratio_band\"]\nlow_hz  = {low:?}\n\
                 high_hz = {high:?}\n",
                quoted(vector),
                number(found.swing_deg),
                quoted(&condition),
                quoted(mag),
                quoted(mag),
            );
            last = "clean";
        } else {
            text += "# ? No compensation: it requires a vector magnetometer and a line with manoeuvres (roll, pitch \
                     and yaw of some degrees).\n";
        }
        if self.map.is_some() {
            text += &format!(
                "\n# The anomaly of the map at each sample.\n[[stages]]\nname  = \"on_map\"\nstage = \
                 \"map_value\"\ninput = \"{last}\"\nmap   = \"anomaly\"\n"
            );
        }
        text
    }

    /// The findings and choices, for the terminal.
    pub fn summary(&self) -> String {
        let mut text = format!("{} ({})\n", self.log.escape_debug(), self.found.format);
        if let Some(name) = self.source.builtin {
            text += &format!("  mapping: {name}, chosen by content\n");
        }
        for table in &self.found.tables {
            let rows: usize = table.lines.values().map(|l| l.rows).sum();
            let name = if table.name.is_empty() { "log" } else { &table.name };
            let columns: Vec<String> = table
                .columns
                .iter()
                .map(|(n, c)| if c.unit.is_empty() { n.clone() } else { format!("{n} [{}]", c.unit) })
                .collect();
            text += &format!(
                "  {name}: {rows} rows, {}, {} Hz\n    {}\n",
                super::super::counted(table.lines.len(), "line"),
                number(table.rate_hz()),
                columns.join(", ").escape_debug()
            );
            let idle = table.columns.iter().filter(|(_, c)| c.known > 1 && c.high == c.low).map(|(n, _)| n.clone());
            let idle: Vec<String> = idle.filter(|n| n != "year" && n != "doy").collect();
            if !idle.is_empty() {
                text += &format!("    constant: {}\n", idle.join(", ").escape_debug());
            }
            if table.faults > 0 {
                text += &format!(
                    "    {} unreadable; `magline run` reports them\n",
                    super::super::counted(table.faults, "row")
                );
            }
        }
        if let Some(main) = self.main() {
            let of = |names: &[String]| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            text += &format!("  scalar magnetometers: {}\n", of(&main.scalars));
            text += &format!("  vector magnetometers: {}\n", of(&main.vectors));
            let line = self.calibration(main).map(|((_, line), _)| line.escape_debug().to_string());
            text += &format!("  calibration line: {}\n", line.unwrap_or_else(|| "none with manoeuvres".to_owned()));
            text += &format!("  date: {}\n", if main.has("year") { "found" } else { "not found" });
        }
        for question in &self.questions {
            text += &format!("  ? {}\n", question.escape_debug());
        }
        text
    }
}

/// A comment with the other candidates.
fn listed(what: &str, names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => format!("# {what}: {one}\n"),
        [first, others @ ..] => format!("# {what}: {first} is used; also found: {}\n", others.join(", ")),
    }
}

/// A rate as a user would write it: whole numbers within 2 per cent, otherwise three digits.
fn rounded(hz: f64) -> f64 {
    let whole = hz.round();
    if whole >= 1.0 && (hz / whole - 1.0).abs() < 0.02 {
        return whole;
    }
    let scale = 10_f64.powf(2.0 - hz.log10().floor());
    (hz * scale).round() / scale
}
