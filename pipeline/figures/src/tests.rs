#![allow(clippy::unwrap_used, clippy::panic)]

mod earth;

use super::*;
use crate::png_file::decode;

/// Map of `columns` by `rows` metres, with a node at each integer.
pub fn picture(columns: usize, rows: usize, values: &[f64]) -> MapPicture<'_> {
    let axis = |len| EvenAxis { first: 0.0, step: 1.0, len };
    MapPicture {
        x: axis(columns),
        y: axis(rows),
        values,
        plane: AxisQuantity::Metres,
        title: "",
        quantity: "Magnetic anomaly",
        unit: "nT",
        x_label: None,
        y_label: None,
    }
}

/// Style with colours only: no shading and no optional parts.
pub fn bare() -> MapStyle {
    MapStyle {
        width_px: 400,
        palette: Palette::Viridis,
        scale: ColourMapping::Linear,
        shade: None,
        colour_bar: false,
        scale_bar: false,
        north: false,
        ..MapStyle::default()
    }
}

/// Dipole-like anomalies with a hole, 40 x 30.
fn anomalies() -> Vec<f64> {
    let bump = |x: f64, y: f64, at: (f64, f64)| (-((x - at.0).powi(2) + (y - at.1).powi(2)) / 30.0).exp();
    (0..1200u32)
        .map(|k| (f64::from(k % 40), f64::from(k / 40)))
        .map(|(x, y)| {
            let hole = (24.0..28.0).contains(&x) && (5.0..9.0).contains(&y);
            let value = 900.0 * bump(x, y, (12.0, 20.0)) - 400.0 * bump(x, y, (12.0, 12.0)) + 3.0 * x;
            if hole { f64::NAN } else { value }
        })
        .collect()
}

fn marks(picture: &MapPicture, look: &MapStyle, tracks: &[TrackLine]) -> Vec<scene::SceneMark> {
    figure::scene(picture, look, tracks).unwrap().marks
}

fn map_of(marks: &[scene::SceneMark]) -> (scene::Rect, (usize, usize), Vec<u8>) {
    let found = marks.iter().find_map(|m| match m {
        scene::SceneMark::Picture { rect, size, pixels } => Some((*rect, *size, pixels.clone())),
        _ => None,
    });
    found.unwrap()
}

fn texts(marks: &[scene::SceneMark]) -> Vec<String> {
    let text =
        |m: &scene::SceneMark| if let scene::SceneMark::Text { text, .. } = m { Some(text.clone()) } else { None };
    marks.iter().filter_map(text).collect()
}

/// Checks that a string is well-formed XML: fails for tags that do not close, an attribute without quotes, a stray `<`
/// or `&`.
pub(crate) fn well_formed(xml: &str) -> Result<usize, String> {
    let mut open: Vec<&str> = vec![];
    let mut elements = 0;
    let mut rest = xml.strip_prefix(svg::XML).ok_or("no declaration")?;
    while let Some(at) = rest.find('<') {
        entities(&rest[..at])?;
        let end = rest[at..].find('>').ok_or("an open tag")? + at;
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            if open.pop() != Some(name) {
                return Err(format!("</{name}> closes something else"));
            }
            continue;
        }
        elements += 1;
        let name = tag.split_whitespace().next().unwrap_or_default();
        let attributes = tag[name.len()..].trim();
        let quoted: Vec<&str> = attributes.split('"').collect();
        if tag.contains('<')
            || quoted.len().is_multiple_of(2)
            || !quoted.iter().step_by(2).all(|q| q.is_empty() || q.ends_with('='))
        {
            return Err(format!("<{tag}>"));
        }
        entities(attributes)?;
        open.push(name);
    }
    let control = xml.chars().find(|c| c.is_control() && *c != '\n');
    if open.is_empty() && rest.trim().is_empty() && control.is_none() {
        Ok(elements)
    } else {
        Err(format!("{open:?} {control:?}"))
    }
}

fn entities(text: &str) -> Result<(), String> {
    let known = ["amp;", "lt;", "gt;", "quot;"];
    let stray = text.split('&').skip(1).find(|after| !known.iter().any(|e| after.starts_with(e)));
    stray.map_or(Ok(()), |s| Err(format!("stray & before {s:.20}")))
}

#[test]
fn unit_xml_check_rejects_malformed_text() {
    let of = |body: &str| well_formed(&format!("{}{body}", svg::XML));
    assert_eq!(of("<a b=\"1\" c=\"&lt;\"><d></d>&amp;</a>\n"), Ok(2));
    for wrong in [
        "<a><b></a></b>",
        "<a>",
        "<a b=1></a>",
        "<a>&</a>",
        "<a>&nbsp;</a>",
        "<a b=\"<\"></a>",
        "<a>\u{1}</a>",
        "<a></a>x",
    ] {
        assert!(of(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn unit_every_known_cell_has_its_colour_and_north_is_up() {
    let values = anomalies();
    let map = picture(40, 30, &values);
    for palette in [Palette::Viridis, Palette::Turbo, Palette::Diverging] {
        for scale in [
            ColourMapping::Linear,
            ColourMapping::Equalised,
            ColourMapping::Percentile(2.0, 98.0),
            ColourMapping::Range(-100.0, 300.0),
        ] {
            let look = MapStyle { palette, scale, blend: false, ..bare() };
            let colours = colours::colour_scale(&map, &look).unwrap();
            let (_, (w, h), pixels) = map_of(&marks(&map, &look, &[]));
            for (k, value) in values.iter().enumerate() {
                // Middle of the cell, rows from the north.
                let column = ((k % 40) as f64 + 0.5) / 40.0 * w as f64;
                let row = (29.5 - (k / 40) as f64) / 30.0 * h as f64;
                let at = 4 * (row as usize * w + column as usize);
                let expected = if value.is_finite() {
                    let [r, g, b] = palette.colour(colours.part(*value));
                    [r, g, b, 255]
                } else {
                    [0; 4]
                };
                assert_eq!(pixels[at..at + 4], expected, "{palette:?} {scale:?} cell {k}");
            }
        }
    }
}

#[test]
fn unit_png_contains_the_map_in_its_frame() {
    let values = [-1.0, 0.0, 1.0, 2.0];
    let png = png(&picture(2, 2, &values), &bare(), &[]).unwrap();
    let ((w, _), pixels) = decode(&png).unwrap();
    assert_eq!(w, 400);
    let (rect, ..) = map_of(&marks(&picture(2, 2, &values), &bare(), &[]));
    let at = |x: f64, y: f64| {
        let k = 3 * (y as usize * w + x as usize);
        [pixels[k], pixels[k + 1], pixels[k + 2]]
    };
    // At a distance of two pixels inside the line of the frame, the corners have the colours of the outer nodes.
    let corners = [
        (at(rect.x + 2.0, rect.bottom() - 3.0), 0.0),
        (at(rect.right() - 3.0, rect.bottom() - 3.0), 1.0 / 3.0),
        (at(rect.x + 2.0, rect.y + 2.0), 2.0 / 3.0),
        (at(rect.right() - 3.0, rect.y + 2.0), 1.0),
    ];
    for (colour, part) in corners {
        assert_eq!(colour, Palette::Viridis.colour(part));
    }
    assert_eq!(at(1.0, 1.0), [255; 3]);
}

#[test]
fn unit_the_colour_bar_ends_where_the_scale_ends() {
    let values = anomalies();
    let map = picture(40, 30, &values);
    for (scale, palette) in [
        (ColourMapping::Linear, Palette::Turbo),
        (ColourMapping::Equalised, Palette::Viridis),
        (ColourMapping::Percentile(5.0, 95.0), Palette::Diverging),
        (ColourMapping::Range(-50.0, 700.0), Palette::Diverging),
    ] {
        let look = MapStyle { scale, palette, colour_bar: true, ..bare() };
        let made = colours::colour_scale(&map, &look).unwrap();
        let drawn = marks(&map, &look, &[]);
        let stops = drawn
            .iter()
            .find_map(|m| if let scene::SceneMark::Fade { colours, .. } = m { Some(colours.clone()) } else { None });
        let stops = stops.unwrap();
        assert_eq!(stops.first(), Some(&palette.colour(made.part(made.low()))));
        assert_eq!(stops.last(), Some(&palette.colour(made.part(made.high()))));
        if scale == ColourMapping::Equalised {
            let known = || values.iter().copied().filter(|v| v.is_finite());
            let ends = [known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max)];
            for end in ends {
                let near =
                    |text: &String| text.replace('\u{2212}', "-").parse::<f64>().is_ok_and(|v| (v - end).abs() <= 0.5);
                assert!(texts(&drawn).iter().any(near), "{end}: {:?}", texts(&drawn));
            }
        }
    }
}

#[test]
fn unit_the_same_map_gives_the_same_bytes() {
    let values = anomalies();
    let map = picture(40, 30, &values);
    let (x, y) = ([2.0, 30.0, f64::NAN, 12.0, 13.0], [3.0, 25.0, 4.0, 4.0, 20.0]);
    let line = TrackLine { name: "1003.02", x: &x, y: &y, colour: None };
    let look = MapStyle { width_px: 500, contours: Some(100.0), ..MapStyle::default() };
    let drawn = || (png(&map, &look, &[line]).unwrap(), svg(&map, &look, &[line]).unwrap());
    assert_eq!(drawn(), drawn());
}

#[test]
fn unit_svg_is_well_formed_for_any_name() {
    let values = anomalies();
    let wild = "a <b> & \"c\" \u{0}\u{7} 'd' ]]> \u{fffe}";
    let map = MapPicture {
        title: wild,
        quantity: wild,
        unit: wild,
        x_label: Some(wild),
        y_label: Some(wild),
        ..picture(40, 30, &values)
    };
    let line = TrackLine { name: wild, x: &[1.0, 9.0], y: &[1.0, 9.0], colour: None };
    let drawn = svg(&map, &MapStyle { contours: Some(50.0), ..MapStyle::default() }, &[line]).unwrap();
    assert!(well_formed(&drawn).unwrap() > 150);
    let chart =
        curve_svg(&[(1.0, 2.0), (3.0, 1.0)], Some(0), &CurveLabels { title: wild, x: wild, y: wild, marked: wild });
    well_formed(&chart.unwrap()).unwrap();
}

#[test]
fn unit_tracks_break_at_gaps_and_are_clipped_at_the_frame() {
    let values = vec![1.0; 100];
    let map = picture(10, 10, &values);
    let (x, y) = ([-50.0, 2.0, f64::NAN, 5.0, 60.0], [5.0; 5]);
    let drawn = marks(&map, &bare(), &[TrackLine { name: "t", x: &x, y: &y, colour: Some([1, 2, 3]) }]);
    let rect = map_of(&drawn).0;
    let own = drawn.iter().find_map(|m| match m {
        scene::SceneMark::Stroke { lines, ink, within: Some(w), .. } if ink.rgb == [1, 2, 3] && *w == rect => {
            Some(lines.clone())
        }
        _ => None,
    });
    let lines = own.unwrap();
    assert_eq!(lines.len(), 2);
    assert!(lines.iter().flatten().all(|s| rect.grown(4.01).holds(*s)));
    // The track begins off the map, so its start is shown only in the legend.
    let discs = drawn.iter().filter(|m| matches!(m, scene::SceneMark::Disc { .. })).count();
    assert_eq!(discs, 1);
}

#[test]
fn unit_longitudes_a_turn_apart_give_the_same_track() {
    let values = vec![1.0; 100];
    let axis = |first| EvenAxis { first, step: 1.0, len: 10 };
    let map = MapPicture { x: axis(175.0), y: axis(-5.0), plane: AxisQuantity::Degrees, ..picture(10, 10, &values) };
    let drawn =
        |x: [f64; 3]| marks(&map, &bare(), &[TrackLine { name: "t", x: &x, y: &[0.0, 1.0, 3.0], colour: None }]);
    assert_eq!(drawn([178.0, 180.5, 183.0]), drawn([178.0, -179.5, -177.0]));
    assert!(texts(&drawn([0.0, 1.0, 2.0])).iter().any(|t| t == "t (off the map)"));
}

#[test]
fn unit_maps_of_all_shapes_stay_on_the_paper() {
    let title = "a very long title that takes many words ".repeat(12) + &"x".repeat(300);
    for (columns, rows, width_px) in
        [(2, 2, 1600), (1, 1, 200), (300, 2, 800), (2, 300, 800), (400, 40, 200), (40, 400, 300), (1000, 3, 1600)]
    {
        for (plane, step) in
            [(AxisQuantity::Metres, 500.0), (AxisQuantity::Degrees, 0.05), (AxisQuantity::Metres, 1e-3)]
        {
            let values: Vec<f64> = (0..columns * rows).map(|k| (k % 7) as f64 - 3.0).collect();
            let axis = |len| EvenAxis { first: 47.0, step, len };
            let map =
                MapPicture { x: axis(columns), y: axis(rows), plane, title: &title, ..picture(columns, rows, &values) };
            let look = MapStyle { width_px, ..MapStyle::default() };
            let scene = figure::scene(&map, &look, &[]).unwrap();
            assert!(scene.height < 4.0 * scene.width, "{columns} x {rows}: {} high", scene.height);
            for mark in &scene.marks {
                let (from, to) = extent(mark);
                let inside =
                    from.0 >= -0.5 && from.1 >= -0.5 && to.0 <= scene.width + 0.5 && to.1 <= scene.height + 0.5;
                assert!(inside, "{columns} x {rows} {plane:?} {step} at {width_px}: {mark:?}");
            }
            assert_eq!(overlap(&scene.marks), None, "{columns} x {rows} {plane:?} {step} at {width_px}");
        }
    }
}

/// Bounding rectangle of a mark, from its upper left to its lower right corner.
fn extent(mark: &scene::SceneMark) -> (scene::PaperPoint, scene::PaperPoint) {
    let around = |spots: Vec<scene::PaperPoint>| {
        let fold =
            |f: fn(f64, f64) -> f64, start: f64| spots.iter().fold((start, start), |a, s| (f(a.0, s.0), f(a.1, s.1)));
        (fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY))
    };
    match mark {
        scene::SceneMark::Fill { points, .. } => around(points.clone()),
        scene::SceneMark::Stroke { within: Some(rect), .. } => around(rect.corners()),
        scene::SceneMark::Stroke { lines, .. } => around(lines.concat()),
        scene::SceneMark::Disc { at, .. } => (*at, *at),
        scene::SceneMark::Picture { rect, .. } | scene::SceneMark::Fade { rect, .. } => around(rect.corners()),
        scene::SceneMark::Text { at, text, size, anchor, turned } => {
            let long = scene::text_width(text, *size);
            let back = match anchor {
                scene::TextAnchor::Start => 0.0,
                scene::TextAnchor::Middle => 0.5 * long,
                scene::TextAnchor::End => long,
            };
            if *turned {
                ((at.0 - 0.75 * size, at.1 + back - long), (at.0 + 0.2 * size, at.1 + back))
            } else {
                ((at.0 - back, at.1 - 0.75 * size), (at.0 - back + long, at.1 + 0.2 * size))
            }
        }
    }
}

/// Two strings that overlap, or a string that overlaps the map.
fn overlap(marks: &[scene::SceneMark]) -> Option<(String, String)> {
    let solid = |m: &&scene::SceneMark| {
        matches!(m, scene::SceneMark::Text { .. } | scene::SceneMark::Picture { .. } | scene::SceneMark::Fade { .. })
    };
    let boxes: Vec<_> = marks.iter().filter(solid).map(|m| (format!("{m:.0?}"), extent(m))).collect();
    for (k, (a, (from, to))) in boxes.iter().enumerate() {
        for (b, (from_b, to_b)) in &boxes[k + 1..] {
            if from.0 < to_b.0 && from_b.0 < to.0 && from.1 < to_b.1 && from_b.1 < to.1 {
                return Some((a.chars().take(200).collect(), b.chars().take(200).collect()));
            }
        }
    }
    None
}

#[test]
fn unit_undrawable_maps_are_rejected() {
    let nan = [f64::NAN; 4];
    let what = |map: &MapPicture, look: &MapStyle| png(map, look, &[]).unwrap_err().what;
    assert!(what(&picture(2, 2, &nan), &bare()).contains("no known value"));
    assert!(what(&picture(2, 3, &nan), &bare()).contains("4 values for 3 rows of 2 columns"));
    assert!(what(&picture(2, 2, &[1.0; 4]), &MapStyle { width_px: 3, ..bare() }).contains("3 pixels"));
    for shade in [
        HillShading { elevation_deg: 0.0, ..HillShading::default() },
        HillShading { strength: f64::NAN, ..HillShading::default() },
    ] {
        assert!(what(&picture(2, 2, &[1.0; 4]), &MapStyle { shade: Some(shade), ..bare() }).contains("hill-shading"));
    }
    let no_step = MapPicture { x: EvenAxis { first: 1e6, step: 1e-12, len: 2 }, ..picture(2, 2, &[1.0; 4]) };
    assert!(what(&no_step, &bare()).contains("columns"));
    let backwards = MapPicture { x: EvenAxis { first: 0.0, step: -1.0, len: 2 }, ..picture(2, 2, &[1.0; 4]) };
    assert!(what(&backwards, &bare()).contains("columns"));
    let values = anomalies();
    let map = picture(40, 30, &values);
    assert!(what(&map, &MapStyle { contours: Some(0.0), ..bare() }).contains("intervals of 0"));
    assert!(what(&map, &MapStyle { contours: Some(0.01), ..bare() }).contains("lines"));
    let line = TrackLine { name: "t", x: &[1.0], y: &[], colour: None };
    assert!(svg(&map, &bare(), &[line]).unwrap_err().what.contains("`t`"));
}

#[test]
fn unit_a_map_of_one_value_is_drawn() {
    let values = [48_000.0; 12];
    let map = picture(4, 3, &values);
    let (_, _, pixels) = map_of(&marks(&map, &MapStyle { width_px: 300, ..MapStyle::default() }, &[]));
    let [r, g, b] = Palette::Turbo.colour(0.5);
    // The middle of the scale is between two adjacent colours; rounding selects one.
    assert!(pixels.chunks_exact(4).all(|p| p.iter().zip([r, g, b, 255]).all(|(a, b)| a.abs_diff(b) <= 1)));
}

#[test]
fn unit_hatching_and_its_legend_appear_only_with_unknown_cells() {
    let mut values = anomalies();
    let named = |values: &[f64]| texts(&marks(&picture(40, 30, values), &bare(), &[])).iter().any(|t| t == "no data");
    assert!(named(&values));
    values.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
    assert!(!named(&values));
}

#[test]
fn gold_a_small_svg() {
    let map = MapPicture { title: "Two by two", ..picture(2, 2, &[0.0, 1.0, 2.0, f64::NAN]) };
    let look = MapStyle { width_px: 240, ..bare() };
    let line = TrackLine { name: "1003.02", x: &[0.0, 1.0], y: &[0.0, 0.5], colour: None };
    let drawn = svg(&map, &look, &[line]).unwrap();
    let (head, tail) = drawn.split_once("data:image/png;base64,").unwrap();
    let (_, tail) = tail.split_once('"').unwrap();
    assert_eq!([head, tail].concat(), include_str!("two_by_two.svg.txt"));
}

#[test]
fn unit_curve_highlights_its_corner() {
    let points: Vec<(f64, f64)> = (-6..=6).map(|k| (10f64.powi(k), 10f64.powi(-k) + 1.0)).collect();
    let labels = CurveLabels { title: "L-curve", x: "misfit (nT)", y: "norm (nT)", marked: "alpha = 1" };
    let drawn = curve_svg(&points, Some(6), &labels).unwrap();
    well_formed(&drawn).unwrap();
    assert!(drawn.contains("<circle class=\"mark\"") && drawn.contains(">alpha = 1</text>"));
    assert!(!curve_svg(&points, None, &labels).unwrap().contains("<circle"));
    assert_eq!(curve_svg(&[(0.0, 1.0), (f64::NAN, 1.0)], None, &labels), None);
}
