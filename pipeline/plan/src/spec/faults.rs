//! The faults of a spec, shown at their position in the file or on the command line.

use schemas::{Fault, render};

use super::SpecSpan;

/// All faults of a spec, ready for display.
#[derive(Clone, Debug)]
pub struct SpecFaults {
    /// The file, as the user named it.
    pub file: String,
    /// Text.
    pub text: String,
    /// The assignments of `--set`, whose bytes follow the bytes of the text.
    pub sets: Vec<String>,
    /// The faults.
    pub faults: Vec<Fault>,
}

impl std::fmt::Display for SpecFaults {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let shown: Vec<String> = self.faults.iter().map(|x| self.show(x)).collect();
        write!(f, "{}", shown.join("\n\n"))
    }
}

impl std::error::Error for SpecFaults {}

/// First byte of each assignment. The assignments follow the text, each after a line break.
pub fn starts(text: &str, sets: &[String]) -> Vec<usize> {
    let next = |at: &mut usize, set: &String| {
        let start = *at;
        *at += set.len() + 1;
        Some(start)
    };
    sets.iter().scan(text.len() + 1, next).collect()
}

impl SpecFaults {
    fn show(&self, fault: &Fault) -> String {
        let starts = starts(&self.text, &self.sets);
        let found = fault.at.as_ref().and_then(|at| starts.iter().rposition(|s| *s <= at.start).map(|i| (i, at)));
        match found {
            Some((i, at)) => on_command_line(fault, &self.sets[i], &(at.start - starts[i]..at.end - starts[i])),
            None => render(fault, &self.file, &self.text),
        }
    }
}

/// Fault of an assignment, with its position in the assignment.
fn on_command_line(fault: &Fault, set: &str, at: &SpecSpan) -> String {
    const BEFORE: &str = "--set ";
    // A character that would break the line is replaced by a character that is one column wide.
    let line: String = set.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    let chars = |to: usize| set.char_indices().take_while(|(i, _)| *i < to).count();
    let (from, to) = (chars(at.start), chars(at.end));
    let marks = "^".repeat(to.saturating_sub(from).max(1));
    let room = " ".repeat(BEFORE.len() + from);
    let help = fault.help.as_ref().map(|h| format!(" {h}")).unwrap_or_default();
    let bare = Fault { help: None, ..fault.clone() };
    format!("error: {bare}\n --> the command line\n  | {BEFORE}{line}\n  | {room}{marks}{help}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_positions_after_the_text_are_on_the_command_line() {
        let faults = SpecFaults {
            file: "a.toml".into(),
            text: "seed = 1".into(),
            sets: vec!["seed=2".into(), "näme=a\nb".into()],
            faults: vec![
                Fault::new("in the file").at(7..8),
                Fault::new("first").at(14..15).help("so"),
                Fault::new("second").at(22..25),
            ],
        };
        assert_eq!(
            faults.to_string(),
            "error: in the file\n --> a.toml:1:8\n1 | seed = 1\n  |        ^\n\n\
             error: first\n --> the command line\n  | --set seed=2\n  |            ^ so\n\n\
             error: second\n --> the command line\n  | --set näme=a\u{fffd}b\n  |            ^^^"
        );
    }
}
