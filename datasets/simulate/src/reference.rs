//! The reference of the synth spec, from its declarations.

use std::fmt::Write;

use schemas::{ChoiceRegistry, ParamDoc, Params, collect_doc};

use crate::{
    aircraft::spec::{electric, sensor},
    earth::spec as earth,
    gnss,
    ins::spec as ins,
    reading::{COMPONENTS, variant::SynthVariant},
    spec::RootKeys,
    trajectory::{air, spec as trajectory},
};

/// The template of the page, with `{{NAME}}` for the keys of a table.
const PAGE: &str = include_str!("reference/page.md");

/// The reference of the synth spec, as Markdown.
pub fn reference() -> String {
    let none = ChoiceRegistry::default();
    let kinds = [electric::kinds(), electric::signals(), trajectory::kinds()];
    let tables: [(&str, String); 19] = [
        ("root", keys(&RootKeys::docs(&none))),
        ("flights", table("[[flights]]", &trajectory::FlightKeys::docs(&none))),
        (
            "lines",
            table("[[flights.lines]]", &trajectory::LineKeys::docs(&kinds[2]))
                + &variants::<trajectory::LinePathKeys>(&kinds[2]),
        ),
        ("wind", table("[wind]", &air::Wind::docs(&none))),
        ("turbulence", table("[turbulence]", &air::TurbulenceKeys::docs(&none))),
        ("dynamics", table("[dynamics]", &air::Dynamics::docs(&none))),
        ("ins", table("[ins]", &ins::InsKeys::docs(&none))),
        ("gnss", table("[gnss]", &gnss::GnssReceiver::docs(&none))),
        ("core_field", table("[core_field]", &earth::CoreKeys::docs(&none))),
        ("map", table("[map]", &earth::MapKeys::docs(&none))),
        ("sources", table("[[sources]]", &earth::BuriedSourceKeys::docs(&none))),
        ("diurnal", table("[diurnal]", &earth::DiurnalKeys::docs(&none))),
        ("magnetometers", table("[[magnetometers]]", &sensor::ScalarKeys::docs(&none))),
        ("vector_magnetometers", table("[[vector_magnetometers]]", &sensor::VectorKeys::docs(&none))),
        (
            "currents",
            table("[[currents]]", &electric::CurrentKeys::docs(&kinds[0]))
                + &variants::<electric::CurrentControl>(&kinds[0]),
        ),
        ("wires", table("[[wires]]", &electric::WireKeys::docs(&none))),
        ("voltages", table("[[voltages]]", &electric::VoltageKeys::docs(&none))),
        (
            "inputs",
            table("[[inputs]]", &electric::InputKeys::docs(&kinds[1]))
                + &variants::<electric::NamedControlQuantity>(&kinds[1]),
        ),
        ("temperature", table("[temperature]", &electric::TemperatureKeys::docs(&none))),
    ];
    let names: Vec<String> = COMPONENTS.iter().map(|name| format!("`{name}`")).collect();
    let mut page = PAGE.replace("{{components}}", &names.join(", "));
    for (name, text) in tables {
        page = page.replace(&format!("{{{{{name}}}}}"), text.trim_end());
    }
    page
}

/// The keys of a table under its name.
fn table(name: &str, docs: &[ParamDoc]) -> String {
    format!("### `{name}`\n\n{}", keys(docs))
}

/// The kinds of a table, each with its own keys.
fn variants<T: crate::reading::variant::SynthVariantValue>(lists: &ChoiceRegistry) -> String {
    let mut out = String::new();
    for kind in lists.get::<SynthVariant<T>>().iter().flat_map(|kinds| kinds.all()) {
        // Writing into a String cannot fail.
        let _ = write!(out, "\n#### `kind = \"{}\"`\n\n{}\n", kind.name, collect_doc(kind.doc));
        let docs = (kind.docs)();
        if !docs.is_empty() {
            let _ = write!(out, "\n{}", keys(&docs));
        }
    }
    out
}

/// Keys as a table; keys inside a key are written as `key.inner`.
fn keys(docs: &[ParamDoc]) -> String {
    let mut out = "| key | type | unit | default | allowed | meaning |\n|---|---|---|---|---|---|\n".to_owned();
    for doc in docs.iter().filter(|doc| doc.owners.is_empty()) {
        row(&mut out, "", doc);
    }
    out
}

fn row(out: &mut String, within: &str, doc: &ParamDoc) {
    out.push_str(&doc.row(within));
    for inner in &doc.keys {
        row(out, &format!("{within}{}.", doc.name), inner);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_every_table_of_the_page_is_filled_in_and_every_key_is_documented() {
        let page = reference();
        assert!(!page.contains("{{") && !page.contains("unset:  |"), "{page}");
        assert!(page.contains("| `init_position_sigma_m` | number | m | `3.0` |"), "{page}");
        assert!(page.contains("| `drift.tau_s` | number | s | `600.0` |"), "{page}");
    }
}
