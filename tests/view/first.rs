//! The first answer of a view, which does not wait for the store or for the plan.

use super::*;

/// Size of the padding of a record, in bytes.
const PADDING: usize = 32 << 20;

#[test]
#[cfg(target_os = "linux")]
fn user_the_page_is_sent_without_a_read_of_the_record_of_the_plan() {
    let bench = ran();
    let record = bench.path("store/plans/small.json");
    let padded = [fs::read(&record).unwrap(), vec![b' '; PADDING]].concat();
    fs::write(&record, padded).unwrap();
    let viewed = Viewed::new(&bench, &["store"]);
    // Bytes that the server has read since its start.
    let bytes = || -> usize {
        let text = fs::read_to_string(format!("/proc/{}/io", viewed.child.id())).unwrap();
        text.lines().find_map(|line| line.strip_prefix("rchar: ")).unwrap().parse().unwrap()
    };
    let page = viewed.get("");
    assert_eq!(page.status, 200);
    assert_eq!(viewed.get("web/style.css").status, 200);
    assert!(bytes() < PADDING, "{} bytes are read before the first answer", bytes());
    let text = String::from_utf8(page.body).unwrap();
    assert!(text.contains("<h1>Store</h1>") && text.contains("id=\"sections\"") && !text.contains("small"), "{text}");
    // The sections are read afterwards, from the record.
    let sections = viewed.json("api/sections");
    assert_eq!(sections["scores"], serde_json::json!(["small.scores"]));
    let runs = viewed.json("api/run")["pipelines"][0]["runs"].clone();
    assert_eq!(sections["runs"], serde_json::json!([{ "pipeline": "small", "run": runs[0]["run"] }]));
    assert!(bytes() > PADDING, "{} bytes are read", bytes());
}

#[test]
fn user_a_view_of_a_spec_is_served_before_its_plan_is_made() {
    let bench = ran();
    // The plan fails: its flights are missing.
    fs::rename(bench.path("flights"), bench.path("moved")).unwrap();
    let known = bench.magline(&["explain", "spec.toml"]);
    let viewed = bench.magline(&["view", "spec.toml"]);
    assert_eq!((viewed.status.code(), known.status.code()), (Some(2), Some(2)), "{}", stderr(&viewed));
    let text = stderr(&viewed);
    let (address, fault) = text.split_once('\n').unwrap();
    assert!(address.starts_with("http://127.0.0.1:"), "{text}");
    assert_eq!(fault, stderr(&known));
}
