//! The same spec and the same inputs give the same bytes.

use crate::support::Bench;

#[test]
fn user_one_thread_and_four_give_the_same_bytes() {
    let bench = Bench::new();
    for (store, threads) in [("one", "1"), ("four", "4")] {
        let done = bench.run(&["--set", &format!("store={store}"), "--threads", threads]);
        assert_eq!(done.code, 0, "{}", done.stderr);
    }
    let (one, four) = (bench.tables("one"), bench.tables("four"));
    assert_eq!(one.keys().collect::<Vec<_>>(), four.keys().collect::<Vec<_>>());
    assert!(one.len() == 10, "{:?}", one.keys());
    for (name, bytes) in &one {
        assert!(four[name] == *bytes, "{name} differs");
    }
}

#[test]
fn user_a_sweep_grown_step_by_step_ends_with_the_same_bytes() {
    let bench = Bench::new();
    assert_eq!(bench.run(&["--set", "store=whole"]).code, 0);
    for step in ["axes.lambda=[0.025]", "axes.mag=[\"mag_5_uc\"]", "axes.vector=[\"flux_d\"]"] {
        assert_eq!(bench.run(&["--set", "store=grown", "--set", step]).code, 0);
    }
    let done = bench.run(&["--set", "store=grown"]);
    assert!(done.total("reused") > 20);
    let (whole, grown) = (bench.tables("whole"), bench.tables("grown"));
    assert_eq!(whole.keys().collect::<Vec<_>>(), grown.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(grown[name] == *bytes, "{name} differs");
    }
}
