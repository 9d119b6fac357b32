//! Curve over two logarithmic axes, such as the L-curve of a regularisation.

use super::svg::{XML, clean};
use crate::chart::{ChartAxis, ChartLine, LineChart};

/// Labels of a curve.
#[derive(Clone, Copy, Debug, Default)]
pub struct CurveLabels<'a> {
    /// Description, for screen readers.
    pub title: &'a str,
    /// Quantity and unit of the horizontal axis.
    pub x: &'a str,
    /// Quantity and unit of the vertical axis.
    pub y: &'a str,
    /// Label of the highlighted point.
    pub marked: &'a str,
}

const STYLE: &str = "\
svg{background:#fff;font:12px 'Helvetica Neue',Helvetica,Arial,'Noto Sans','DejaVu Sans',sans-serif}\
text{fill:#1a1a1a}.name{font-size:13px}.grid{stroke:#e3e6ea}.frame{fill:none;stroke:#1a1a1a}\
.line{fill:none;stroke:#0072b2;stroke-width:2;stroke-linejoin:round}\
circle.mark{fill:#fff;stroke:#d55e00;stroke-width:2.5}\
text.mark{font-size:13px;paint-order:stroke;stroke:#fff;stroke-width:4px}";

/// Curve through `points`, both axes logarithmic, with the point of index `marked` ringed and labelled, as an SVG file.
/// Points that are not finite and positive interrupt the curve; `None` without valid points.
pub fn curve_svg(points: &[(f64, f64)], marked: Option<usize>, labels: &CurveLabels) -> Option<String> {
    let mark = marked.and_then(|k| points.get(k)).map(|(x, y)| (clean(labels.marked), *x, *y));
    let chart = LineChart {
        title: clean(labels.title),
        x: ChartAxis::new(clean(labels.x)).log(),
        y: ChartAxis::new(clean(labels.y)).log(),
        lines: vec![ChartLine { name: String::new(), class: "curve", points: points.to_vec() }],
        marks: mark.into_iter().collect(),
        height: 560.0,
        ..LineChart::default()
    };
    Some(format!("{XML}{}\n", chart.file(STYLE)?.into_string()))
}
