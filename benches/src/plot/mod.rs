//! Figures as SVG: common elements, and [`panel`], charts of lines, dots and cells.
//!
//! All colours are legible on white and on black, since the background is unknown.

pub mod panel;

use std::fmt::{Display, Write};

/// The colour of texts and axes.
pub const TEXT: &str = "#767e88";

/// A document under construction.
pub struct Svg(String);

/// Escapes text for XML.
pub fn escaped(text: impl Display) -> String {
    text.to_string().replace('&', "&amp;").replace('<', "&lt;")
}

impl Svg {
    /// A document of that size, px.
    pub fn new(title: &str, width: impl Display, height: impl Display) -> Svg {
        Svg(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             font-family=\"sans-serif\" font-size=\"11\" fill=\"{TEXT}\">\n<title>{}</title>\n",
            escaped(title)
        ))
    }

    /// Appends an element verbatim.
    pub fn element(&mut self, element: impl Display) {
        writeln!(self.0, "{element}").unwrap();
    }

    /// A text that begins at a position, with further `attributes`.
    pub fn text(&mut self, [x, y]: [&dyn Display; 2], attributes: &str, text: impl Display) {
        let space = if attributes.is_empty() { "" } else { " " };
        self.element(format_args!("<text x=\"{x}\" y=\"{y}\"{space}{attributes}>{}</text>", escaped(text)));
    }

    /// A horizontal line at height `y`, with a label to its left.
    pub fn tick(&mut self, y: f64, [left, right]: [f64; 2], opacity: &str, name: impl Display) {
        self.element(format_args!(
            "<path d=\"M{left} {y:.1}H{right}\" stroke=\"{TEXT}\" stroke-opacity=\"{opacity}\"/>"
        ));
        self.text([&(left - 6.0), &format_args!("{:.1}", y + 4.0)], "text-anchor=\"end\"", name);
    }

    /// A filled rectangle without an outline; `inside` holds child elements, such as a title.
    pub fn rect(&mut self, [x, y]: [&dyn Display; 2], [width, height]: [&dyn Display; 2], fill: &str, inside: &str) {
        let end = if inside.is_empty() { "/>".to_string() } else { format!(">{inside}</rect>") };
        self.element(format_args!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"{fill}\"{end}"
        ));
    }

    /// The document.
    pub fn finish(self) -> String {
        self.0 + "</svg>\n"
    }
}
