//! The scripts of the page. A script uses only earlier scripts.

/// A script of the page.
pub struct PageScript {
    /// Path below the folder of this file, and below the address of a view.
    pub name: &'static str,
    /// The text.
    pub text: &'static str,
    /// Whether the script is needed only for series of lines.
    pub of_series: bool,
}

/// A script in this folder.
macro_rules! script {
    ($name:literal, $of_series:literal) => {
        PageScript { name: $name, text: include_str!($name), of_series: $of_series }
    };
}

/// All scripts.
pub const SCRIPTS: &[PageScript] = &[
    script!("web/vendor/notice.js", true),
    script!("web/vendor/uPlot.iife.min.js", true),
    script!("web/vendor/flechette.min.js", true),
    script!("script.js", false),
    script!("web/scores.js", false),
    script!("web/draw.js", false),
    script!("web/views.js", false),
    script!("web/pivot.js", false),
    script!("web/paired.js", false),
    script!("web/compare.js", false),
    script!("web/source.js", true),
    script!("web/columns.js", true),
    script!("web/explorer.js", false),
    script!("web/against.js", false),
    script!("web/legible.js", false),
    script!("web/zoom.js", false),
    script!("web/panels.js", true),
    script!("web/figure.js", true),
    script!("web/coast.js", true),
    script!("web/maplayers.js", true),
    script!("web/contours.js", true),
    script!("web/modes.js", true),
    script!("web/track.js", true),
    script!("web/trackload.js", true),
    script!("web/spectrum.js", true),
    script!("web/columnlist.js", true),
    script!("web/line.js", true),
    script!("web/pipelinepair.js", true),
    script!("web/pipelines.js", true),
    script!("web/sections.js", true),
    script!("web/run.js", true),
    script!("web/modelview.js", true),
    script!("web/lineage.js", true),
    script!("web/profile.js", true),
    script!("web/mappicture.js", true),
    script!("web/maps.js", true),
    script!("web/print.js", false),
];

/// The style sheet of the page.
pub const STYLE: &str = include_str!("style.css");
