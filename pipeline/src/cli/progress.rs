//! The progress display: a bar on a terminal, otherwise a line every 10 s.

use std::{
    io::{IsTerminal, Write},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use plan::spec::{SearchTrial, SearchTrialScore};
use results::text::number;
use run::{Event, Listener};
use schemas::one_line;

use super::counted;

/// Interval of lines when output is not a terminal.
const INTERVAL: Duration = Duration::from_secs(10);
/// Minimum elapsed time for an estimate of the remaining time.
const KNOWN_AFTER: Duration = Duration::from_secs(1);

/// Progress display on standard error, or in another place, that ends when this value is dropped. All methods may be
/// called from several threads concurrently.
pub struct ProgressDisplay(Option<ProgressOutput>);

struct ProgressOutput {
    shared: Arc<ProgressShared>,
    bar: Option<ProgressBar>,
    writer: Option<JoinHandle<()>>,
}

struct ProgressShared {
    begun: Instant,
    state: Mutex<ProgressState>,
    over: Condvar,
}

/// Progress at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgressSnapshot {
    /// Current stage, such as `computing track`.
    pub what: String,
    /// Number of finished parts of the stage.
    pub done: usize,
    /// Number of all parts; 0 while unknown.
    pub all: usize,
}

impl ProgressDisplay {
    /// Creates progress without output, for [`ProgressDisplay::snapshot`].
    pub fn unseen() -> ProgressDisplay {
        ProgressDisplay(Some(ProgressOutput { shared: ProgressShared::new(INTERVAL), bar: None, writer: None }))
    }

    /// Present progress; `None` before the first stage, and with quiet output.
    pub fn snapshot(&self) -> Option<ProgressSnapshot> {
        let state = self.0.as_ref()?.shared.lock();
        let (what, done, all) = (state.subject(), state.done, state.all);
        (!state.what.is_empty()).then_some(ProgressSnapshot { what, done, all })
    }

    /// Creates a display on standard error; none if `quiet`.
    pub fn new(quiet: bool) -> ProgressDisplay {
        if quiet {
            return ProgressDisplay(None);
        }
        if std::io::stderr().is_terminal() {
            return ProgressDisplay(Some(ProgressOutput {
                shared: ProgressShared::new(INTERVAL),
                bar: Some(bar()),
                writer: None,
            }));
        }
        ProgressDisplay::lines(INTERVAL, std::io::stderr())
    }

    /// Writes a line to `out` every `interval`, even without new progress.
    fn lines(interval: Duration, mut out: impl Write + Send + 'static) -> ProgressDisplay {
        let shared = ProgressShared::new(interval);
        let of_thread = shared.clone();
        let write = move || {
            let mut state = of_thread.lock();
            while !state.over {
                if let Some(line) = state.due(of_thread.begun.elapsed()) {
                    // The reader may have closed the stream.
                    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
                }
                let wait = state.next.saturating_sub(of_thread.begun.elapsed());
                state = of_thread.over.wait_timeout(state, wait).unwrap_or_else(PoisonError::into_inner).0;
            }
        };
        // If no thread can be started, no progress is displayed.
        let writer = std::thread::Builder::new().name("progress".to_owned()).spawn(write).ok();
        ProgressDisplay(Some(ProgressOutput { shared, bar: None, writer }))
    }

    /// Starts another stage. The estimate of the remaining time restarts; repeating the current stage has no effect.
    pub fn stage(&self, what: &str) {
        self.change(|state, now| state.stage(now, what));
    }

    /// Sets the progress: `done` of `all` parts of the stage are finished. `all` is 0 while unknown.
    pub fn set(&self, done: usize, all: usize) {
        self.change(|state, _| (state.done, state.all) = (done, all));
    }

    /// Sets the name of the parts (`lines`) and the current part.
    pub fn detail(&self, parts: &str, at: &str) {
        self.change(|state, _| (state.parts, state.at) = (parts.to_owned(), at.to_owned()));
    }

    fn change(&self, how: impl FnOnce(&mut ProgressState, Duration)) {
        let Some(shown) = &self.0 else { return };
        let now = shown.shared.begun.elapsed();
        let mut state = shown.shared.lock();
        how(&mut state, now);
        if let Some(bar) = &shown.bar {
            bar.set_length(state.all as u64);
            bar.set_position(state.done as u64);
            if state.measured != (state.all > 0) {
                state.measured = state.all > 0;
                bar.set_style(style(state.measured));
            }
            bar.set_message(state.text(now));
        }
    }
}

impl Drop for ProgressDisplay {
    fn drop(&mut self) {
        let Some(shown) = &mut self.0 else { return };
        shown.shared.lock().over = true;
        shown.shared.over.notify_all();
        if let Some(bar) = &shown.bar {
            bar.finish_and_clear();
        }
        if let Some(writer) = shown.writer.take() {
            // The thread only writes the display, so a failure of the thread is ignored.
            let _ = writer.join();
        }
    }
}

impl ProgressShared {
    fn new(interval: Duration) -> Arc<ProgressShared> {
        let state = Mutex::new(ProgressState { interval, next: interval, ..ProgressState::default() });
        Arc::new(ProgressShared { begun: Instant::now(), state, over: Condvar::new() })
    }

    fn lock(&self) -> MutexGuard<'_, ProgressState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr()).with_style(style(false));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Style of the display: a bar if the number of parts is known.
fn style(measured: bool) -> ProgressStyle {
    let template = if measured { "{elapsed_precise} {bar:24} {msg}" } else { "{elapsed_precise} {spinner} {msg}" };
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Current stage and its start. The methods read no clock: the time since the start of the display is an argument.
#[derive(Debug, Default)]
struct ProgressState {
    /// Prefix of each stage.
    within: String,
    what: String,
    begun: Duration,
    parts: String,
    at: String,
    done: usize,
    all: usize,
    /// Whether the displayed bar has a length.
    measured: bool,
    interval: Duration,
    next: Duration,
    over: bool,
}

impl ProgressState {
    fn stage(&mut self, now: Duration, what: &str) {
        if self.what != what {
            *self = ProgressState {
                within: std::mem::take(&mut self.within),
                what: what.to_owned(),
                begun: now,
                measured: self.measured,
                interval: self.interval,
                next: self.next,
                over: self.over,
                ..ProgressState::default()
            };
        }
    }

    /// The line that is due now, if any.
    fn due(&mut self, now: Duration) -> Option<String> {
        if now < self.next {
            return None;
        }
        self.next = now + self.interval;
        let seconds = now.as_secs();
        (!self.what.is_empty()).then(|| format!("{}:{:02} {}", seconds / 60, seconds % 60, self.text(now)))
    }

    /// Stage and current part.
    fn subject(&self) -> String {
        let at = if self.at.is_empty() { String::new() } else { format!(", {}", self.at) };
        one_line(&format!("{}{}{at}", self.within, self.what)).into_owned()
    }

    fn text(&self, now: Duration) -> String {
        let mut text = self.subject();
        if self.all > 0 {
            text.push_str(&format!(": {} of {}", self.done, self.all));
            if !self.parts.is_empty() {
                text.push_str(&format!(" {}", self.parts));
            }
        }
        if let Some(left) = self.left(now) {
            text.push_str(&format!(" (about {} left)", spelt(left)));
        }
        one_line(&text).into_owned()
    }

    /// Estimated remaining time of the stage; `None` if it cannot be estimated yet.
    fn left(&self, now: Duration) -> Option<Duration> {
        let passed = now.saturating_sub(self.begun);
        if self.done == 0 || self.done >= self.all || passed < KNOWN_AFTER {
            return None;
        }
        Some(passed.mul_f64((self.all - self.done) as f64 / self.done as f64))
    }
}

/// Text with the running trials of a search and the best trial so far.
fn within(rows: &[SearchTrial], trials: usize, best: Option<&SearchTrialScore>) -> String {
    let ends = rows.first().zip(rows.last()).map(|(first, last)| match (first.rung, first.trial == last.trial) {
        (1, true) => format!("trial {} of {trials}", first.trial),
        (1, false) => format!("trials {} to {} of {trials}", first.trial, last.trial),
        (rung, _) => format!("{} of {trials} at rung {rung}", counted(rows.len(), "trial")),
    });
    let best = best.and_then(|b| Some(format!(", best {} (trial {})", number(Some(b.goal?)), b.row.trial)));
    format!("{}{}: ", ends.unwrap_or_default(), best.unwrap_or_default())
}

/// A duration as text.
fn spelt(time: Duration) -> String {
    match time.as_secs() {
        s @ 0..90 => format!("{} s", s.max(1)),
        s @ 90..5400 => format!("{} min", (s + 30) / 60),
        s => format!("{:.1} h", s as f64 / 3600.0),
    }
}

impl Listener for ProgressDisplay {
    fn on_event(&self, event: &Event) {
        match event {
            Event::Reading { table, step } => {
                let file = step.file.file_name().unwrap_or_default().to_string_lossy();
                if step.simulated {
                    self.stage(&format!("simulating {table}"));
                    self.detail("lines", &file);
                    self.set(step.lines, step.of_lines.unwrap_or(0));
                } else {
                    self.stage(&format!("reading {table}"));
                    let at = if step.lines > 0 { format!("{file}, line {}", step.lines) } else { file.into_owned() };
                    self.detail(if step.all == 1 { "file" } else { "files" }, &at);
                    self.set(step.done, step.all);
                }
            }
            Event::Started { .. } => self.stage("looking up results in the store"),
            Event::Computing { table, units } => {
                self.stage(&format!("computing {table}"));
                self.set(0, *units);
            }
            Event::Unit { outcome: run::UnitOutcome::Computed | run::UnitOutcome::Failed, .. } => {
                self.change(|state, _| state.done = (state.done + 1).min(state.all));
            }
            Event::Unit { .. } => {}
            Event::Working { progress, .. } => self.change(|state, _| state.at = (*progress).to_owned()),
            Event::Waiting { what } => {
                let at = what.map(|what| format!("waiting for {what}")).unwrap_or_default();
                self.change(|state, _| state.at = at);
            }
            Event::Searching { rows, trials, best } => {
                let within = within(rows, *trials, *best);
                self.change(|state, _| (state.within, state.what) = (within, String::new()));
            }
            Event::Trials { .. } => self.change(|state, _| state.within.clear()),
            Event::Trying { table, remedy } => {
                self.stage(&format!("trying a remedy for a warning about {table}: {remedy}"))
            }
            Event::Publishing { table } => self.stage(&format!("publishing {table}")),
            Event::Table { .. } | Event::Finished { .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn seconds(s: u64) -> Duration {
        Duration::from_secs(s)
    }

    #[test]
    fn unit_no_estimate_is_shown_without_a_basis() {
        let mut state = ProgressState { interval: seconds(10), next: seconds(10), ..ProgressState::default() };
        state.stage(seconds(0), "simulating flights");
        assert_eq!(state.text(seconds(60)), "simulating flights");
        (state.done, state.all, state.parts) = (0, 9, "lines".to_owned());
        assert_eq!(state.text(seconds(60)), "simulating flights: 0 of 9 lines");
        state.done = 3;
        assert_eq!(state.text(seconds(60)), "simulating flights: 3 of 9 lines (about 2 min left)");
        // The remaining time of a stage is not estimated from the time of an earlier stage.
        state.stage(seconds(60), "computing even");
        (state.done, state.all) = (1, 2);
        assert_eq!(state.text(seconds(60)), "computing even: 1 of 2");
        state.done = 2;
        assert_eq!(state.text(seconds(90)), "computing even: 2 of 2");
    }

    #[test]
    fn unit_a_line_is_due_every_ten_seconds() {
        let mut state = ProgressState { interval: seconds(10), next: seconds(10), ..ProgressState::default() };
        assert_eq!(state.due(seconds(10)), None, "there is nothing to say yet");
        state.stage(seconds(10), "gridding");
        let due_s: Vec<u64> = (10..=75).filter(|s| state.due(seconds(*s)).is_some()).collect();
        assert_eq!(due_s, [20, 30, 40, 50, 60, 70]);
        assert_eq!(state.due(seconds(85)).unwrap(), "1:25 gridding");
    }

    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn unit_lines_appear_without_events_and_are_plain_text() {
        let kept = Kept::default();
        let progress = ProgressDisplay::lines(Duration::from_millis(5), kept.clone());
        progress.stage("computing track");
        progress.set(1, 4);
        // No progress is reported during this wait, as in a stage that takes several minutes.
        let begun = Instant::now();
        while kept.0.lock().unwrap().is_empty() && begun.elapsed() < seconds(20) {
            std::thread::sleep(Duration::from_millis(2));
        }
        drop(progress);
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        assert!(text.starts_with("0:00 computing track"), "{text:?}");
        assert!(!text.contains(['\u{1b}', '\r']), "{text:?}");
        let lines = text.lines().count();
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(String::from_utf8(kept.0.lock().unwrap().clone()).unwrap().lines().count(), lines, "it has ended");
    }

    #[test]
    fn user_progress_names_the_file_that_is_read_or_simulated() {
        use plan::sources::ReadProgress;
        let progress = ProgressDisplay::lines(seconds(60), Kept::default());
        let text = || progress.0.as_ref().map(|s| s.shared.lock().text(Duration::ZERO)).unwrap_or_default();
        let file = std::path::Path::new("flights/osborne.synth.toml");
        let step = ReadProgress { simulated: true, lines: 3, of_lines: Some(9), ..ReadProgress::of_file(file, 0, 1) };
        progress.on_event(&Event::Reading { table: "flights", step: &step });
        assert_eq!(text(), "simulating flights, osborne.synth.toml: 3 of 9 lines");
        let step = ReadProgress { lines: 12, ..ReadProgress::of_file(std::path::Path::new("a/1003.csv"), 1, 4) };
        progress.on_event(&Event::Reading { table: "flights", step: &step });
        assert_eq!(text(), "reading flights, 1003.csv, line 12: 1 of 4 files");
    }

    #[test]
    fn user_progress_shows_the_trials_of_a_search_and_the_best() {
        let progress = ProgressDisplay::lines(seconds(60), Kept::default());
        let text = || progress.0.as_ref().map(|s| s.shared.lock().text(Duration::ZERO)).unwrap_or_default();
        let row = |trial, rung| SearchTrial { trial, generation: 1, rung, values: vec![] };
        progress.on_event(&Event::Searching { rows: &[row(1, 1), row(2, 1)], trials: 8, best: None });
        progress.on_event(&Event::Computing { table: "clean", units: 3 });
        assert_eq!(text(), "trials 1 to 2 of 8: computing clean: 0 of 3");
        let best = SearchTrialScore {
            row: row(2, 1),
            goal: Some(3.25),
            cost: Some(3.25),
            lines: 1,
            error: None,
            promoted: true,
        };
        progress.on_event(&Event::Searching { rows: &[row(2, 2)], trials: 8, best: Some(&best) });
        progress.on_event(&Event::Computing { table: "terms", units: 0 });
        assert_eq!(text(), "1 trial of 8 at rung 2, best 3.250 (trial 2): computing terms");
        progress.on_event(&Event::Searching { rows: &[row(8, 1)], trials: 8, best: Some(&best) });
        progress.on_event(&Event::Publishing { table: "clean" });
        assert_eq!(text(), "trial 8 of 8, best 3.250 (trial 2): publishing clean");
    }

    #[test]
    fn unit_a_snapshot_has_the_counts_of_the_stage() {
        let progress = ProgressDisplay::unseen();
        assert_eq!(progress.snapshot(), None);
        progress.on_event(&Event::Computing { table: "clean", units: 3 });
        let snapshot = |done| ProgressSnapshot { what: "computing clean".to_owned(), done, all: 3 };
        assert_eq!(progress.snapshot(), Some(snapshot(0)));
        progress.set(2, 3);
        assert_eq!(progress.snapshot(), Some(snapshot(2)));
        assert_eq!(ProgressDisplay::new(true).snapshot(), None);
    }

    #[test]
    fn user_quiet_prints_nothing() {
        let progress = ProgressDisplay::new(true);
        progress.stage("x");
        progress.set(1, 2);
        assert!(progress.0.is_none());
    }
}
