//! A drawing area of latitude and longitude, with its frame, scale bar and north arrow.

use maud::{Markup, html};
use numerics::angle::wrap_deg;
use numerics::earth::geodesy::EarthModel;

use super::{
    chart::px,
    raster::Bounds,
    ticks::{fixed, linear, round_below},
};

/// Width of a picture, in pixels.
pub const SIDE: f64 = 440.0;
/// Left edge of the widest area in the picture, in pixels.
pub const LEFT: f64 = 74.0;
const RIGHT: f64 = 22.0;
const TOP: f64 = 6.0;
const BOTTOM: f64 = 38.0;

/// Drawing area, and its range of latitudes and longitudes.
pub struct Canvas {
    bounds: Bounds,
    width: f64,
    height: f64,
}

impl Canvas {
    /// Area with the aspect ratio of `bounds`.
    pub fn new(bounds: Bounds) -> Canvas {
        let shrink = (0.5 * (bounds.lat.0 + bounds.lat.1)).to_radians().cos().max(0.01);
        let (wide, high) = ((bounds.lon.1 - bounds.lon.0) * shrink, bounds.lat.1 - bounds.lat.0);
        let scale = (SIDE - LEFT - RIGHT) / wide.max(high);
        Canvas { bounds, width: (wide * scale).max(150.0), height: (high * scale).max(100.0) }
    }

    /// Length of a degree of longitude in the picture, in pixels.
    pub fn per_degree_east(&self) -> f64 {
        self.width / (self.bounds.lon.1 - self.bounds.lon.0)
    }

    /// x coordinate of a longitude, shifted by a full turn if necessary.
    pub fn x(&self, lon: f64) -> f64 {
        let (west, east) = self.bounds.lon;
        let middle = 0.5 * (west + east);
        (middle + wrap_deg(lon - middle) - west) * self.per_degree_east()
    }

    /// y coordinate of a latitude; north is up.
    pub fn y(&self, lat: f64) -> f64 {
        (self.bounds.lat.1 - lat) / (self.bounds.lat.1 - self.bounds.lat.0) * self.height
    }

    /// Position of a latitude and longitude; `None` for a position far outside the area.
    pub fn spot(&self, (lat, lon): (f64, f64)) -> Option<(f64, f64)> {
        let (x, y) = (self.x(lon), self.y(lat));
        // Positions far outside are dropped; the neighbouring positions keep the direction of the line.
        let near = |v: f64, side: f64| (-side..2.0 * side).contains(&v);
        (near(x, self.width) && near(y, self.height)).then_some((x, y))
    }

    /// Whether a position (latitude and longitude) is in the picture.
    pub fn holds(&self, (lat, lon): (f64, f64)) -> bool {
        (0.0..self.width).contains(&self.x(lon)) && (0.0..self.height).contains(&self.y(lat))
    }

    /// Metres on the ground per unit of the picture.
    pub fn metres_per_px(&self) -> f64 {
        let lat = 0.5 * (self.bounds.lat.0 + self.bounds.lat.1);
        let (west, east) = self.bounds.lon;
        let (_, wide) = EarthModel::default().offset_ne_m((lat, west), (lat, east), 0.0);
        wide.abs() / self.width
    }

    /// Left edge of the area, which is centred in the picture.
    fn left(&self) -> f64 {
        LEFT + 0.5 * (SIDE - LEFT - RIGHT - self.width).max(0.0)
    }

    /// Whole picture: the contents, clipped at the frame, and the latitudes and longitudes around the frame.
    pub fn framed(&self, label: &str, inside: Markup) -> Markup {
        let (left, w, h) = (px(self.left()), px(self.width), px(self.height));
        html! {
            svg viewBox=(format!("0 0 {SIDE} {}", px(TOP + self.height + BOTTOM))) role="img" aria-label=(label) {
                svg x=(left) y=(TOP) width=(w) height=(h) viewBox=(format!("0 0 {w} {h}")) {
                    rect.ground width=(w) height=(h) {}
                    (inside)
                }
                rect.frame x=(left) y=(TOP) width=(w) height=(h) {}
                (self.degrees())
            }
        }
    }

    fn degrees(&self) -> Markup {
        let (left, b) = (self.left(), &self.bounds);
        let (bottom, middle) = (TOP + self.height, TOP + 0.5 * self.height);
        html! {
            @for tick in linear(b.lon.0, b.lon.1, ((self.width / 75.0) as usize).max(2)) {
                @let x = px(left + self.x(tick.at));
                line.stroke x1=(x) x2=(x) y1=(px(bottom)) y2=(px(bottom + 4.0)) {}
                text.tick x=(x) y=(px(bottom + 15.0)) text-anchor="middle" { (tick.label) }
            }
            @for tick in linear(b.lat.0, b.lat.1, 6) {
                @let y = TOP + self.y(tick.at);
                line.stroke x1=(px(left - 4.0)) x2=(px(left)) y1=(px(y)) y2=(px(y)) {}
                text.tick x=(px(left - 6.0)) y=(px(y + 4.0)) text-anchor="end" { (tick.label) }
            }
            text.name x=(px(left + 0.5 * self.width)) y=(px(bottom + 32.0)) text-anchor="middle" { "longitude, °" }
            text.name transform=(format!("translate({} {}) rotate(-90)", px(left - LEFT + 11.0), px(middle)))
                text-anchor="middle" {
                "latitude, °"
            }
        }
    }

    /// Scale bar and north arrow, in the corners where the marks hide the fewest of `spots`.
    pub fn furniture(&self, spots: &[(f64, f64)]) -> Markup {
        let (metres, long) = self.scale();
        let bar = self.corner(spots, (long + 10.0, 25.0), None);
        let north = self.corner(spots, (24.0, 34.0), Some(bar));
        html! {
            (scale_bar(metres, long, self.place(bar, (long + 10.0, 25.0))))
            (north_arrow(self.place(north, (24.0, 34.0))))
        }
    }

    /// Length of the scale bar in metres, which is a round number, and in px.
    fn scale(&self) -> (f64, f64) {
        let metres = round_below(0.3 * self.width * self.metres_per_px());
        (metres, metres / self.metres_per_px())
    }

    /// Number of the corner, other than `taken`, in which an object covers the fewest spots. The corners in the order
    /// of their numbers are bottom left, top right, bottom right, top left.
    fn corner(&self, spots: &[(f64, f64)], size: (f64, f64), taken: Option<usize>) -> usize {
        const AROUND: f64 = 8.0;
        let covered = |corner: usize| {
            let (x, y) = self.place(corner, size);
            let (xs, ys) = (x - AROUND..x + size.0 + AROUND, y - AROUND..y + size.1 + AROUND);
            spots.iter().filter(|s| xs.contains(&s.0) && ys.contains(&s.1)).count()
        };
        (0..4).filter(|c| Some(*c) != taken).min_by_key(|c| covered(*c)).unwrap_or(0)
    }

    /// Upper left corner of an object of this size that is placed in a corner of the area.
    fn place(&self, corner: usize, (width, height): (f64, f64)) -> (f64, f64) {
        const MARGIN: f64 = 6.0;
        let (left, right) = (MARGIN, self.width - width - MARGIN);
        let (top, bottom) = (MARGIN, self.height - height - MARGIN);
        match corner {
            0 => (left, bottom),
            1 => (right, top),
            2 => (right, bottom),
            _ => (left, top),
        }
    }
}

fn scale_bar(metres: f64, long: f64, (x, y): (f64, f64)) -> Markup {
    let label =
        if metres >= 1000.0 { format!("{} km", fixed(metres / 1000.0, 0)) } else { format!("{} m", fixed(metres, 0)) };
    html! {
        g transform=(format!("translate({} {})", px(x), px(y))) {
            rect.plate width=(px(long + 10.0)) height="25" rx="3" {}
            path.bar d=(format!("M5 14v6h{}v-6", px(long))) {}
            text.plated x=(px(0.5 * long + 5.0)) y="12.5" text-anchor="middle" { (label) }
        }
    }
}

fn north_arrow((x, y): (f64, f64)) -> Markup {
    html! {
        g transform=(format!("translate({} {})", px(x), px(y))) {
            rect.plate width="24" height="34" rx="3" {}
            path.needle d="M12 3L17 17L12 14L7 17Z" {}
            text.plated x="12" y="30" text-anchor="middle" { "N" }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn canvas() -> Canvas {
        Canvas::new(Bounds { lat: (-22.2, -21.8), lon: (140.5, 140.9) })
    }

    #[test]
    fn unit_degree_lengths_keep_the_ground_aspect_ratio() {
        let canvas = canvas();
        let (per_lon, per_lat) = (canvas.width / 0.4, canvas.height / 0.4);
        assert!((per_lon / per_lat - 22f64.to_radians().cos()).abs() < 1e-3);
        assert!(canvas.y(-21.8).abs() < 1e-9, "north is up");
        assert!(canvas.x(140.5).abs() < 1e-9 && (canvas.x(140.9) - canvas.width).abs() < 1e-9);
    }

    #[test]
    fn unit_scale_bar_length_matches_its_label() {
        let canvas = canvas();
        let (metres, long) = canvas.scale();
        assert_eq!(metres, 10_000.0);
        // 0.4 degrees of longitude at 22 degrees south are 41.3 km.
        assert!((long / canvas.width - 10.0 / 41.28).abs() < 1e-3);
    }

    #[test]
    fn unit_scale_bar_and_arrow_avoid_the_track() {
        let canvas = canvas();
        let low_left = vec![(15.0, canvas.height - 15.0); 3];
        assert_eq!(canvas.corner(&low_left, (90.0, 25.0), None), 1);
        assert_eq!(canvas.corner(&low_left, (24.0, 34.0), Some(1)), 2);
        assert_eq!(canvas.corner(&[], (90.0, 25.0), None), 0);
    }
}
