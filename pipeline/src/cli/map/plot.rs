//! `magline map plot`: a map as a picture or for Google Earth, with tracks on it.

use std::path::{Path, PathBuf};

use arrow_array::{cast::AsArray, types::Float64Type};
use clap::{Args, ValueEnum};
use datasets::{AnomalyGrid, FlightOptions, ReadHints};
use figures::{AxisQuantity, ColourMapping, EarthTrack, HillShading, MapPicture, MapStyle, Palette, TrackLine};
use intake::open_flight;
use schemas::{Fault, canonical::FlightConversion};

use super::{ExitReason, InputArgs, ThreadArgs, say, wrong};

#[derive(Args)]
pub struct PlotArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// The output file: .png or .svg, or .kml or .kmz for Google Earth.
    #[arg(short, long)]
    output: PathBuf,
    /// Flight files; each line is drawn as a track.
    #[arg(long, num_args = 1.., value_name = "FLIGHTS")]
    track: Vec<PathBuf>,
    /// Draw only these lines of the flights.
    #[arg(long, value_delimiter = ',')]
    line: Vec<String>,
    /// Draw the positions of the INS instead of the true positions.
    #[arg(long)]
    ins: bool,
    /// The title above the map. Default: the name of the map file.
    #[arg(long)]
    title: Option<String>,
    /// The width of the image, in pixels.
    #[arg(long, default_value_t = 1600)]
    width: usize,
    /// The colour palette.
    #[arg(long, value_enum, default_value_t = PaletteName::Turbo)]
    palette: PaletteName,
    /// The colour scale: `equalised`, `linear`, a range `LOW..HIGH` in nT, or percentiles `LOW%..HIGH%`.
    #[arg(long, default_value = "equalised", allow_hyphen_values = true)]
    scale: String,
    /// Draw without hill shading.
    #[arg(long)]
    no_shade: bool,
    /// The contour interval, in nT.
    #[arg(long)]
    contours: Option<f64>,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Colour scales.
#[derive(Clone, Copy, ValueEnum)]
enum PaletteName {
    /// The usual rainbow of potential-field maps, but without its false edges.
    Turbo,
    /// Dark blue to yellow, readable without red or green.
    Viridis,
    /// Blue over white to red, white at zero.
    Diverging,
}

/// Positions of one flight line.
struct PlotTrack {
    name: String,
    lat: Vec<f64>,
    lon: Vec<f64>,
    alt: Vec<f64>,
}

pub fn run(args: &PlotArgs) -> Result<(), ExitReason> {
    args.threads.run(|| {
        let map = args.input.read(&args.map)?;
        let mut tracks = vec![];
        for path in &args.track {
            tracks.extend(lines(args, path)?);
        }
        let ending = args.output.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        match ending.as_str() {
            "png" => write(&args.output, &flat(args, &map, &tracks, figures::png)?),
            "svg" => write(&args.output, flat(args, &map, &tracks, figures::svg)?.as_bytes()),
            "kml" | "kmz" => earth(args, &map, &tracks, ending == "kmz"),
            _ => {
                let fault = Fault::new(format!("`{}` is not a supported image format", args.output.display()));
                Err(fault.help("use the extension .png, .svg, .kml or .kmz").into())
            }
        }
    })
}

fn look(args: &PlotArgs) -> Result<MapStyle, ExitReason> {
    let palette = match args.palette {
        PaletteName::Turbo => Palette::Turbo,
        PaletteName::Viridis => Palette::Viridis,
        PaletteName::Diverging => Palette::Diverging,
    };
    Ok(MapStyle {
        width_px: args.width,
        palette,
        scale: scale(&args.scale)?,
        shade: (!args.no_shade).then(HillShading::default),
        contours: args.contours,
        ..MapStyle::default()
    })
}

fn scale(text: &str) -> Result<ColourMapping, ExitReason> {
    let ends = |a: &str, b: &str| Some((a.parse::<f64>().ok()?, b.parse::<f64>().ok()?));
    let range = text.split_once("..");
    let percent = range.and_then(|(a, b)| ends(a.strip_suffix('%')?, b.strip_suffix('%')?));
    match (text, percent, range.and_then(|(a, b)| ends(a, b))) {
        ("equalised", _, _) => Ok(ColourMapping::Equalised),
        ("linear", _, _) => Ok(ColourMapping::Linear),
        (_, Some((a, b)), _) => Ok(ColourMapping::Percentile(a, b)),
        (_, _, Some((a, b))) => Ok(ColourMapping::Range(a, b)),
        _ => {
            let fault = Fault::new(format!("`{text}` is not a colour scale"));
            Err(fault
                .help("use `equalised`, `linear`, a range such as `-200..300`, or percentiles such as `2%..98%`")
                .into())
        }
    }
}

fn title(args: &PlotArgs) -> String {
    let stem = || args.map.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    args.title.clone().unwrap_or_else(stem)
}

fn quantity(map: &AnomalyGrid) -> &'static str {
    if map.value_unit == "nT" { "Magnetic anomaly" } else { "Derivative of the anomaly" }
}

/// A picture in the map's projection.
fn flat<T>(
    args: &PlotArgs,
    map: &AnomalyGrid,
    tracks: &[PlotTrack],
    draw: impl Fn(&MapPicture, &MapStyle, &[TrackLine]) -> Result<T, Fault>,
) -> Result<T, ExitReason> {
    let plane = map.plane();
    let (unit_x, unit_y) = map.unit_m();
    let places: Vec<(Vec<f64>, Vec<f64>)> = tracks
        .iter()
        .map(|t| {
            let place = |(lat, lon): (&f64, &f64)| match map.is_geographic() {
                true => (*lon, *lat),
                false => map.crs.project(*lat, *lon).map_or((f64::NAN, f64::NAN), |(e, n)| (e * unit_x, n * unit_y)),
            };
            t.lat.iter().zip(&t.lon).map(place).unzip()
        })
        .collect();
    let drawn: Vec<TrackLine> =
        tracks.iter().zip(&places).map(|(track, (x, y))| TrackLine { name: &track.name, x, y, colour: None }).collect();
    let title = title(args);
    let (x, y, kind) = if map.is_geographic() {
        (map.x, map.y, AxisQuantity::Degrees)
    } else {
        (plane.east_m, plane.north_m, AxisQuantity::Metres)
    };
    let picture = MapPicture {
        x,
        y,
        values: &plane.values,
        plane: kind,
        title: &title,
        quantity: quantity(map),
        unit: map.value_unit,
        x_label: None,
        y_label: None,
    };
    draw(&picture, &look(args)?, &drawn).map_err(|e| ExitReason::from(e.in_file(&args.map.display().to_string())))
}

fn earth(args: &PlotArgs, map: &AnomalyGrid, tracks: &[PlotTrack], zipped: bool) -> Result<(), ExitReason> {
    let map = if map.is_geographic() { map.clone() } else { map.to_crs(4326, None).map_err(Fault::from)? };
    let title = title(args);
    let picture = MapPicture {
        x: map.x,
        y: map.y,
        values: &map.anomaly_nt,
        plane: AxisQuantity::Degrees,
        title: &title,
        quantity: quantity(&map),
        unit: map.value_unit,
        x_label: None,
        y_label: None,
    };
    let drawn: Vec<EarthTrack> = tracks
        .iter()
        .map(|t| EarthTrack {
            name: &t.name,
            lat_deg: &t.lat,
            lon_deg: &t.lon,
            alt_m: &t.alt,
            time_unix_s: None,
            colour: None,
        })
        .collect();
    let stem = args.output.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let made = figures::kml(&picture, &look(args)?, &drawn, &stem)?;
    if zipped {
        return write(&args.output, &made.kmz()?);
    }
    for (name, bytes) in &made.files {
        write(&args.output.with_file_name(name), bytes)?;
    }
    write(&args.output, made.document.as_bytes())
}

/// Lines of a flight file to draw.
fn lines(args: &PlotArgs, path: &Path) -> Result<Vec<PlotTrack>, ExitReason> {
    let in_file = |fault: Fault| ExitReason::from(fault.in_file(&path.display().to_string()));
    let reader = open_flight(path, &FlightOptions::default(), &ReadHints::default()).map_err(Fault::from)?;
    let rules = FlightConversion::new(reader.schema()).map_err(|faults| {
        let first = faults.into_iter().next().unwrap_or_else(|| Fault::data("is not a flight table"));
        in_file(first)
    })?;
    let names = if args.ins { ["ins_lat", "ins_lon", "ins_alt"] } else { ["lat", "lon", "alt"] };
    let mut tracks: Vec<PlotTrack> = vec![];
    for batch in reader {
        let batch = rules.apply(&batch.map_err(Fault::from)?).map_err(in_file)?;
        let column = |name: &str| batch.column_by_name(name);
        let absent = |name: &str| in_file(Fault::data("the flights do not have this column").in_column(name));
        let number = |name: &str| column(name).and_then(|a| a.as_primitive_opt::<Float64Type>()).map(|a| a.values());
        let text = |name: &str| column(name).and_then(|a| a.as_string_opt::<i32>()).ok_or_else(|| absent(name));
        let (flight, line) = (text("flight")?, text("line")?);
        let lat = number(names[0]).ok_or_else(|| absent(names[0]))?;
        let lon = number(names[1]).ok_or_else(|| absent(names[1]))?;
        let alt = number(names[2]);
        for i in (0..batch.num_rows()).filter(|i| args.line.is_empty() || args.line.iter().any(|l| l == line.value(*i)))
        {
            let name = format!("{} {}", flight.value(i), line.value(i));
            if tracks.last().is_none_or(|t| t.name != name) {
                tracks.push(PlotTrack { name, lat: vec![], lon: vec![], alt: vec![] });
            }
            if let Some(track) = tracks.last_mut() {
                track.lat.push(lat[i]);
                track.lon.push(lon[i]);
                track.alt.push(alt.map_or(0.0, |a| a[i]));
            }
        }
    }
    if tracks.is_empty() {
        return Err(wrong(path, &"`--line` selects no line of the flights"));
    }
    Ok(tracks)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), ExitReason> {
    std::fs::write(path, bytes)
        .map_err(|e| ExitReason::Failed(format!("error: cannot write {}: {e}", path.display())))?;
    say(format!("{}\n", path.display()))
}
