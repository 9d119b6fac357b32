//! `magline report --figures`: the figures of a report as files.

use std::{collections::BTreeSet, fs};

use crate::support::{Bench, stderr, stdout};

#[test]
fn user_every_figure_of_the_page_is_a_file_with_a_caption() {
    let bench = Bench::new();
    assert_eq!(bench.run(&[]).code, 0);
    let output = bench.magline(&["report", "spec.toml", "-o", "page.html", "--figures", "out/figures"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let page = fs::read_to_string(bench.path("page.html")).unwrap();
    let drawn = page.matches("role=\"img\"").count();
    let folder = bench.path("out/figures");
    let names = || -> BTreeSet<String> {
        fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    };
    let files = names();
    assert!(stdout(&output).contains(&format!("{drawn} figures")), "{}", stdout(&output));
    assert_eq!(files.len(), drawn + 1, "{files:?}");
    let captions = fs::read_to_string(folder.join("captions.md")).unwrap();
    for name in files.iter().filter(|name| name.ends_with(".svg")) {
        assert!(captions.contains(&format!("**{name}** ")), "{name}");
        let svg = fs::read_to_string(folder.join(name)).unwrap();
        assert!(svg.starts_with("<svg ") && svg.contains("xmlns=\"http://www.w3.org/2000/svg\""), "{name}");
        assert!(!svg.contains("var(--") && !svg.contains("http://www.w3.org/1999/xhtml"), "{name}");
        for id in svg.split("url(#").skip(1).chain(svg.split("href=\"#").skip(1)) {
            let id = id.split([')', '"']).next().unwrap();
            assert!(svg.contains(&format!("id=\"{id}\"")), "{name} refers to {id}, which is on the page");
        }
    }

    // The user's files stay; figures of the earlier report do not.
    fs::write(folder.join("001-mine.svg"), "mine").unwrap();
    let first = files.iter().next().unwrap();
    fs::write(folder.join("captions.md"), format!("{captions}\n**999-old.svg** Old.\n\n**../page.html** No.\n"))
        .unwrap();
    fs::write(folder.join("999-old.svg"), "old").unwrap();
    let before = fs::read(folder.join(first)).unwrap();
    let output = bench.magline(&["report", "spec.toml", "--figures", "out/figures"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let mut expected = files.clone();
    expected.insert("001-mine.svg".to_owned());
    assert_eq!(names(), expected);
    assert!(bench.path("page.html").exists());
    assert_eq!(fs::read(folder.join(first)).unwrap(), before, "the same bytes");

    for (args, message) in [
        (&["report", "spec.toml", "-o", "a.kml", "--figures", "x"][..], "`--figures` cannot be combined"),
        (&["report", "spec.toml"], "required"),
    ] {
        let output = bench.magline(args);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    }
}
