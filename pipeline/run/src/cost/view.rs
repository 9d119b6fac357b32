//! `magline explain --cost`: the cost of a run, as a table or as JSON.

use results::text;
use serde_json::{Value, json};

use crate::cost::{RunCost, TableCost};

/// The cost as a table.
pub fn table(cost: &RunCost) -> String {
    let head = ["table", "stage", "stored", "to compute", "rows", "bytes", "processor", "memory"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(cost.tables.iter().map(row));
    let mut out = text::columns(&rows, 2);
    let nothing = cost.tables.iter().all(|t| t.units == 0);
    if nothing {
        return out + "\nall results are in the store; a run computes nothing\n";
    }
    out += &format!(
        "\ntotal: {} rows, {} in the store, {} of processor time ({} of it overhead outside the tables)\n",
        count(cost.rows()),
        bytes(cost.bytes()),
        seconds(cost.seconds()),
        seconds(cost.overhead_s),
    );
    let threads = if cost.threads == 1 { "1 thread".to_owned() } else { format!("{} threads", cost.threads) };
    out += &format!(
        "estimated time: {} with {threads} on this machine (relative speed {:.2}), {} of memory\n",
        seconds(cost.clock()),
        cost.speed,
        bytes(cost.memory()),
    );
    if cost.assumed > 0 {
        out += &format!(
            "the parameter values of {} trials are assumed, because the search has not chosen them yet\n",
            cost.assumed
        );
    }
    out += &match cost.measured {
        0 => "based on built-in measurements, because this store has no measured table\n".to_owned(),
        1 => "based on 1 table measured in this store, and on built-in measurements\n".to_owned(),
        n => format!("based on {n} tables measured in this store, and on built-in measurements\n"),
    };
    out
}

fn row(t: &TableCost) -> Vec<String> {
    let mut row = vec![t.table.clone(), t.stage.clone()];
    if !t.kept {
        row.extend(["not kept", "as required"].map(str::to_owned));
        return row;
    }
    row.extend([t.there.to_string(), t.units.to_string()]);
    if t.units > 0 {
        row.extend([count(t.rows), bytes(t.bytes), seconds(t.seconds), bytes(t.memory)]);
    }
    row
}

/// The cost as one JSON object.
pub fn json(cost: &RunCost) -> Value {
    let whole = |x: f64| json!(x.round() as u64);
    let one = |t: &TableCost| {
        json!({
            "table": t.table, "stage": t.stage, "kept": t.kept, "compute": t.units, "there": t.there,
            "rows": whole(t.rows), "rows_there": t.rows_there, "bytes": whole(t.bytes), "processor_s": t.seconds,
            "clock_s": t.clock, "memory_bytes": whole(t.memory),
        })
    };
    json!({
        "tables": cost.tables.iter().map(one).collect::<Vec<_>>(),
        "rows": whole(cost.rows()), "bytes": whole(cost.bytes()), "processor_s": cost.seconds(),
        "processor_s_beside": cost.overhead_s, "clock_s": cost.clock(), "memory_bytes": whole(cost.memory()),
        "threads": cost.threads, "speed": cost.speed, "measured": cost.measured,
        "trials_assumed": cost.assumed,
    })
}

/// Rounds to two significant digits, because an estimate is not more precise.
fn rounded(x: f64) -> f64 {
    if x <= 0.0 || !x.is_finite() {
        return 0.0;
    }
    let unit = 10_f64.powf(x.log10().floor() - 1.0);
    (x / unit).round() * unit
}

fn count(x: f64) -> String {
    grouped(rounded(x))
}

/// A whole number with commas between the thousands.
fn grouped(x: f64) -> String {
    let digits = format!("{x:.0}");
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

fn shown(x: f64, unit: &str) -> String {
    let x = rounded(x);
    if x < 10.0 { format!("{x:.1} {unit}") } else { format!("{} {unit}", grouped(x)) }
}

fn bytes(x: f64) -> String {
    match x {
        x if x >= 1e12 => shown(x / 1e12, "TB"),
        x if x >= 1e9 => shown(x / 1e9, "GB"),
        x if x >= 1e6 => shown(x / 1e6, "MB"),
        x => shown(x / 1e3, "kB"),
    }
}

fn seconds(x: f64) -> String {
    match x {
        x if x >= 36_000.0 => shown(x / 3600.0, "h"),
        x if x >= 600.0 => shown(x / 60.0, "min"),
        x if x >= 1.0 => shown(x, "s"),
        x => shown(x * 1e3, "ms"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_figures_are_shown_with_two_digits() {
        assert_eq!((count(1_234_567.0), count(0.0), count(7.0)), ("1,200,000".into(), "0".into(), "7".into()));
        assert_eq!(
            (bytes(1_234.0), bytes(56_789_000.0), bytes(2.34e9)),
            ("1.2 kB".into(), "57 MB".into(), "2.3 GB".into())
        );
        assert_eq!(
            (seconds(0.0123), seconds(59.4), seconds(7200.0)),
            ("12 ms".into(), "59 s".into(), "120 min".into())
        );
        assert_eq!(seconds(86_400.0), "24 h");
    }
}
