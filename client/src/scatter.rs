//! A scatter plot as SVG: named dots over two logarithmic axes, each with a line to a larger value along x.
//!
//! Colours are legible on white and on black, since the background is unknown.

use std::fmt::Write;

const COLOURS: [&str; 5] = ["#4389d8", "#cf7a2f", "#3f9b6c", "#9a6bd1", "#c2556b"];
const TEXT: &str = "#767e88";
const SIZE: [f64; 2] = [720.0, 420.0];
/// Left, top, right and bottom rim of the plot.
const RIM: [f64; 4] = [80.0, 24.0, 560.0, 360.0];
/// Minimum distance of labels, px.
const LABEL_PX: f64 = 16.0;
/// Ticks of an axis: these multiples of powers of ten.
const TICKS: [f64; 3] = [1.0, 2.0, 5.0];

/// A named dot.
#[derive(Clone, Debug)]
pub struct Dot {
    /// Label beside the dot.
    pub name: String,
    /// x and y; not drawn unless both are positive and finite.
    pub at: [f64; 2],
    /// End of the line along x.
    pub to_x: f64,
}

/// The figure.
pub struct Scatter<'a> {
    /// Label of the x axis.
    pub x: &'a str,
    /// Label of the y axis.
    pub y: &'a str,
    /// Coloured in this order.
    pub dots: &'a [Dot],
}

impl Scatter<'_> {
    /// The SVG document; `None` without a dot to draw.
    pub fn svg(&self) -> Option<String> {
        let is_drawn = |value: f64| value > 0.0 && value.is_finite();
        let dots: Vec<&Dot> = self.dots.iter().filter(|dot| dot.at.into_iter().all(is_drawn)).collect();
        let xs = dots.iter().flat_map(|dot| [dot.at[0], dot.to_x]).filter(|x| is_drawn(*x));
        let x_axis = Axis::over(xs, RIM[0], RIM[2])?;
        let y_axis = Axis::over(dots.iter().map(|dot| dot.at[1]), RIM[3], RIM[1])?;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"13\">\n",
            SIZE[0], SIZE[1]
        );
        self.axes(&mut svg, &x_axis, &y_axis);
        let labels = apart(&dots.iter().map(|dot| y_axis.place(dot.at[1])).collect::<Vec<_>>());
        for (number, (dot, label)) in dots.iter().zip(labels).enumerate() {
            let colour = COLOURS[number % COLOURS.len()];
            let (x, y, end) = (x_axis.place(dot.at[0]), y_axis.place(dot.at[1]), x_axis.place(dot.to_x.max(dot.at[0])));
            let text = RIM[2] + 14.0;
            line(&mut svg, [x, y], [end, y], colour, 2.0);
            line(&mut svg, [end, y - 4.0], [end, y + 4.0], colour, 2.0);
            line(&mut svg, [end + 4.0, y], [text - 4.0, label], colour, 0.5);
            element(&mut svg, format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{colour}\"/>"));
            let name = escaped(&dot.name);
            let label = label + 4.0;
            element(&mut svg, format_args!("<text x=\"{text:.1}\" y=\"{label:.1}\" fill=\"{colour}\">{name}</text>"));
        }
        Some(svg + "</svg>\n")
    }

    fn axes(&self, svg: &mut String, x_axis: &Axis, y_axis: &Axis) {
        let [left, top, right, bottom] = RIM;
        for tick in x_axis.ticks() {
            let x = x_axis.place(tick);
            line(svg, [x, top], [x, bottom], TEXT, 0.3);
            let y = bottom + 18.0;
            element(
                svg,
                format_args!("<text x=\"{x:.1}\" y=\"{y}\" fill=\"{TEXT}\" text-anchor=\"middle\">{tick}</text>"),
            );
        }
        for tick in y_axis.ticks() {
            let y = y_axis.place(tick);
            line(svg, [left, y], [right, y], TEXT, 0.3);
            let (x, y) = (left - 8.0, y + 4.0);
            element(
                svg,
                format_args!("<text x=\"{x}\" y=\"{y:.1}\" fill=\"{TEXT}\" text-anchor=\"end\">{tick}</text>"),
            );
        }
        line(svg, [left, bottom], [right, bottom], TEXT, 1.0);
        line(svg, [left, top], [left, bottom], TEXT, 1.0);
        let (x, y) = (0.5 * (left + right), bottom + 42.0);
        let name = escaped(self.x);
        element(svg, format_args!("<text x=\"{x}\" y=\"{y}\" fill=\"{TEXT}\" text-anchor=\"middle\">{name}</text>"));
        let (middle, name) = (0.5 * (top + bottom), escaped(self.y));
        element(
            svg,
            format_args!(
                "<text transform=\"translate(18 {middle}) rotate(-90)\" fill=\"{TEXT}\" text-anchor=\"middle\">{name}</text>"
            ),
        );
    }
}

/// A logarithmic axis from `first` to `last` in values and in px.
struct Axis {
    range: [f64; 2],
    px: [f64; 2],
}

impl Axis {
    /// An axis with a margin around the values; `None` without values.
    fn over(values: impl Iterator<Item = f64>, first_px: f64, last_px: f64) -> Option<Axis> {
        let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
        (low <= high).then_some(Axis { range: [low / 1.5, high * 1.5], px: [first_px, last_px] })
    }

    fn place(&self, value: f64) -> f64 {
        let share = (value / self.range[0]).ln() / (self.range[1] / self.range[0]).ln();
        self.px[0] + share * (self.px[1] - self.px[0])
    }

    /// Ticks inside the range; only powers of ten over more than three decades.
    fn ticks(&self) -> Vec<f64> {
        let decades = [self.range[0].log10().floor() as i32, self.range[1].log10().ceil() as i32];
        let steps = if (self.range[1] / self.range[0]).log10() > 3.0 { &TICKS[..1] } else { &TICKS[..] };
        let inside = |tick: &f64| (self.range[0]..=self.range[1]).contains(tick);
        // Parsed from text, so that 0.3 is not 0.30000000000000004.
        let tick = |step: &f64, decade: i32| format!("{step}e{decade}").parse().unwrap_or(step * 10f64.powi(decade));
        (decades[0]..=decades[1])
            .flat_map(|decade| steps.iter().map(move |step| tick(step, decade)))
            .filter(inside)
            .collect()
    }
}

/// Label heights near these, without overlap, in the same order.
fn apart(heights: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..heights.len()).collect();
    order.sort_by(|a, b| heights[*a].total_cmp(&heights[*b]));
    let mut places = heights.to_vec();
    for pair in 1..order.len() {
        let above = places[order[pair - 1]];
        places[order[pair]] = places[order[pair]].max(above + LABEL_PX);
    }
    // Labels below the plot are pushed back up.
    let mut bottom = RIM[3];
    for &index in order.iter().rev() {
        places[index] = places[index].min(bottom);
        bottom = places[index] - LABEL_PX;
    }
    places
}

fn line(svg: &mut String, from: [f64; 2], to: [f64; 2], colour: &str, width: f64) {
    let ([x1, y1], [x2, y2]) = (from, to);
    element(
        svg,
        format_args!(
            "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
        ),
    );
}

fn element(svg: &mut String, element: std::fmt::Arguments) {
    // Writing to a string is infallible.
    writeln!(svg, "{element}").unwrap_or_default();
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn dot(name: &str, x: f64, y: f64) -> Dot {
        Dot { name: name.into(), at: [x, y], to_x: 2.0 * x }
    }

    #[test]
    fn dots_are_drawn_at_their_values() {
        let axis = Axis::over([0.1, 10.0].into_iter(), 0.0, 100.0).unwrap();
        assert!((axis.place(1.0) - 50.0).abs() < 1e-9 && axis.place(0.1) > 0.0 && axis.place(10.0) < 100.0);
        assert_eq!(axis.ticks(), [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0]);
        let dots = [dot("a<b", 0.1, 0.01), dot("c", 0.2, 0.02), dot("not drawn", f64::NAN, 1.0)];
        let svg = Scatter { x: "ms", y: "px", dots: &dots }.svg().unwrap();
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains(">a&lt;b<") && !svg.contains("not drawn") && svg.trim_end().ends_with("</svg>"));
        assert!(Scatter { x: "", y: "", dots: &dots[2..] }.svg().is_none());
    }

    #[test]
    fn labels_do_not_cover_each_other() {
        let places = apart(&[350.0, 352.0, 100.0, 355.0]);
        let mut sorted = places.clone();
        sorted.sort_by(f64::total_cmp);
        assert!(sorted.windows(2).all(|pair| pair[1] - pair[0] >= LABEL_PX) && sorted[3] <= RIM[3], "{places:?}");
        assert!(places[2] == 100.0 && places[0] < places[1] && places[1] < places[3]);
    }
}
