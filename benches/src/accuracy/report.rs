//! The text and the figures of docs/accuracy.md.

use super::basin::{self, Basin};
use super::condition::Row;
use super::curves::{self, Curve};
use super::run::Measured;
use super::{consistency, table};
use crate::page;

/// All measurements of one run.
pub struct Report {
    /// The rows of the table and their results.
    pub rows: Vec<(Row, Measured)>,
    /// S0, S30 and S60 over many frames.
    pub long: Vec<Measured>,
    /// Basins by light.
    pub basins: Vec<Basin>,
    /// Error against saturation.
    pub saturation: Curve,
    /// Error against a lobe, by document.
    pub glare: Vec<Curve>,
    /// Error against occlusion.
    pub occlusion: Curve,
}

impl Report {
    /// The page's text.
    pub fn text(&self) -> String {
        let lines: Vec<String> = self.rows.iter().map(|(row, measured)| table::centre_line(row, measured)).collect();
        let measured: Vec<&Measured> = self.rows.iter().map(|(_, measured)| measured).collect();
        let frames = measured.iter().map(|measured| measured.cold.frames).max().unwrap_or(0);
        let long = self.long.iter().map(|measured| measured.cold.frames).max().unwrap_or(0);
        let parts = [
            format!(
                "{} All processors at work, so times are on the long side.",
                page::provenance("accuracy", &["tracker", "jit", "symbolic", "benches/src", "models"])
                    .replace(", one thread;", ";")
            ),
            format!(
                "## Centre\n\n{frames} frames a row: a ratio scatters by {:.1} %. Figures that miss what is to be reached stand in bold.\n\n{}\n{}",
                50.0 / (frames.max(1) as f64).sqrt(),
                table::HEAD,
                lines.join("\n")
            ),
            format!(
                "## Size, brightness, covariance, time\n\nTracking. Bias ± its standard error, then the standard deviation of one frame. NEES of the centre is 2 when the covariance is honest; 1.8 to 2.2 is asked. Time is that of one call of `Tracker::track`, the search for starting values included.\n\n{}",
                table::frame_worth(&measured)
            ),
            format!(
                "## Covariance\n\n{long} frames each. The columns of percentages: so many of the frames should lie inside their own confidence ellipse; that many do.\n\n{}\n![Covariance consistency](accuracy-covariance.svg)",
                consistency::table(&self.long)
            ),
            format!(
                "## Saturation\n\nBeside it what least squares over all pixels makes of size and brightness, as Gaussian fitters do.\n\n{}\n![Error against saturation](accuracy-saturation.svg)",
                curves::table("saturated", &[&self.saturation])
            ),
            format!(
                "## Glare\n\nA lobe of growing height beside a spot of S30, by what the document says of the background.\n\n{}\n![Error against glare](accuracy-glare.svg)",
                curves::table("lobe, DN", &self.glare.iter().collect::<Vec<_>>())
            ),
            format!(
                "## Occlusion\n\n{}\n![Error against occlusion](accuracy-occlusion.svg)",
                curves::table("hidden", &[&self.occlusion])
            ),
            format!(
                "## From how far a fit finds the spot\n\nThe share of starts, round and some way off, from which `spot-plane` ends within 0.1 px and 5 % of the size. The thesis' staging (first the centre with a huge spot, then the shape) succeeds from none of them.\n\n{}\n![Basin of convergence](accuracy-basin.svg)",
                basin::table(&self.basins)
            ),
        ];
        parts.join("\n\n")
    }

    /// Writes the page and its figures.
    pub fn write(&self) {
        page::write_to("accuracy.md", "accuracy", &self.text());
        let rows: Vec<&Measured> = self.rows.iter().map(|(_, measured)| measured).collect();
        for (name, svg) in [
            ("accuracy-covariance.svg", consistency::figure(&rows, &self.long)),
            ("accuracy-saturation.svg", curves::saturation_figure(&self.saturation)),
            ("accuracy-glare.svg", curves::glare_figure(&self.glare)),
            ("accuracy-occlusion.svg", curves::occlusion_figure(&self.occlusion)),
            ("accuracy-basin.svg", basin::figure(&self.basins)),
        ] {
            page::write_svg(name, &svg);
        }
    }
}
