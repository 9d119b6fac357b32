//! The magline command: spec, plan, store, run, and the views of them.
