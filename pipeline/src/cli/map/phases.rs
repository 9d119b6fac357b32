//! What long work on a map is doing: a bar on a terminal, elsewhere a line every ten seconds.

use std::{
    io::{IsTerminal, Write},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, RecvTimeoutError, Sender},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// How often a line is written where nobody can see a bar.
const EVERY: Duration = Duration::from_secs(10);

/// What is being done, how much of it is done, and out of how much.
type Now = Arc<Mutex<(String, usize, usize)>>;

/// The phases of a piece of work.
pub(super) struct Phases {
    now: Now,
    bar: Option<ProgressBar>,
    lines: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Phases {
    /// On standard error.
    pub(super) fn new() -> Phases {
        if std::io::stderr().is_terminal() {
            let style = ProgressStyle::with_template("{elapsed:>4} {spinner} {msg:32} {wide_bar} {pos}/{len}");
            let bar = ProgressBar::with_draw_target(Some(1), ProgressDrawTarget::stderr());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.enable_steady_tick(Duration::from_millis(200));
            return Phases { now: Now::default(), bar: Some(bar), lines: None };
        }
        Phases::lines(EVERY, |line| {
            // A reader that has gone away does not stop the work.
            let _ = writeln!(std::io::stderr().lock(), "{line}");
        })
    }

    /// A line after each stretch of `every`.
    fn lines(every: Duration, mut write: impl FnMut(String) + Send + 'static) -> Phases {
        let now = Now::default();
        let (stop, stopped) = mpsc::channel();
        let (seen, start) = (now.clone(), Instant::now());
        let thread = std::thread::spawn(move || {
            while stopped.recv_timeout(every) == Err(RecvTimeoutError::Timeout) {
                let (what, done, all) = seen.lock().unwrap_or_else(PoisonError::into_inner).clone();
                let part = if all > 1 { format!(", {done} of {all} done") } else { String::new() };
                write(format!("{what}{part}, {:.0} s so far", start.elapsed().as_secs_f64()));
            }
        });
        Phases { now, bar: None, lines: Some((stop, thread)) }
    }

    /// `done` of `all` steps of `what` are done.
    pub(super) fn at(&self, what: &str, done: usize, all: usize) {
        if let Some(bar) = &self.bar {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
            bar.set_message(what.to_owned());
        }
        *self.now.lock().unwrap_or_else(PoisonError::into_inner) = (what.to_owned(), done, all);
    }
}

impl Drop for Phases {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        if let Some((stop, thread)) = self.lines.take() {
            drop(stop);
            // A line that could not be written is all that can have failed.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn r10_a_line_is_written_as_time_goes_by_and_none_after_the_end() {
        let (out, lines) = mpsc::channel();
        let phases = Phases::lines(Duration::from_millis(20), move |line| drop(out.send(line)));
        phases.at("equivalent sources", 2, 7);
        std::thread::sleep(Duration::from_millis(200));
        phases.at("reading", 0, 1);
        std::thread::sleep(Duration::from_millis(200));
        drop(phases);
        let told: Vec<String> = lines.iter().collect();
        assert!(told[0].starts_with("equivalent sources, 2 of 7 done, 0 s"), "{told:?}");
        assert!(told.last().is_some_and(|line| line.starts_with("reading, 0 s")), "{told:?}");
    }
}
