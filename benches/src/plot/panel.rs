//! Small charts: lines, dots and shaded cells in panels side by side.

use super::{Svg, TEXT, escaped};

/// Colours of series, in order.
pub const COLOURS: [&str; 5] = ["#4389d8", "#cf7a2f", "#3f9b6c", "#9a6bd1", "#c2556b"];
/// From this number of ticks on, labels are slanted.
const CROWDED: usize = 10;
const PANEL: [f64; 2] = [430.0, 330.0];
/// Line height of the legend, px.
const NAME: f64 = 17.0;
/// Legend rows that fit below a panel.
const NAMES_FIT: usize = 3;
/// Origin of a panel's axes, from its top left; its upper and right rim.
const ORIGIN: [f64; 2] = [62.0, 240.0];
const TOP: f64 = 34.0;
const RIGHT: f64 = 415.0;

/// An axis of a panel.
#[derive(Clone, Debug, Default)]
pub struct Axis {
    /// Label.
    pub name: String,
    /// First and last value.
    pub range: [f64; 2],
    /// Positions and labels of lines.
    pub ticks: Vec<(f64, String)>,
    /// Logarithmic scale.
    pub logarithmic: bool,
}

impl Axis {
    /// An axis with a number at each tick.
    pub fn linear(name: &str, range: [f64; 2], ticks: &[f64]) -> Axis {
        let ticks = ticks.iter().map(|tick| (*tick, tick.to_string())).collect();
        Axis { name: name.to_string(), range, ticks, logarithmic: false }
    }

    /// The same with a logarithmic scale.
    pub fn logarithmic(name: &str, range: [f64; 2], ticks: &[f64]) -> Axis {
        Axis { logarithmic: true, ..Axis::linear(name, range, ticks) }
    }

    /// The position of a value as a share of the axis, clamped to its ends.
    fn share(&self, value: f64) -> f64 {
        let [first, last] = self.range;
        let share = match self.logarithmic {
            true => (value / first).ln() / (last / first).ln(),
            false => (value - first) / (last - first),
        };
        share.clamp(0.0, 1.0)
    }
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line with a dot at each point.
    Line,
    /// A dashed line without dots.
    Dashed,
    /// Dots alone.
    Dots,
}

/// A series of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// One of [`COLOURS`], or any.
    pub colour: &'static str,
    /// How it is drawn.
    pub style: Style,
    /// x, y; points that are not finite are left out.
    pub points: Vec<[f64; 2]>,
}

/// A shaded rectangle with a text in it.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Its middle, in values of the axes.
    pub place: [f64; 2],
    /// 0 to 1.
    pub shade: f64,
    /// Text in its middle.
    pub text: String,
}

/// A text beside a point.
#[derive(Clone, Debug)]
pub struct Label {
    /// The point, in values of the axes.
    pub place: [f64; 2],
    /// Right of the point, or left of it if it does not fit.
    pub text: String,
    /// Colour of the text.
    pub colour: &'static str,
}

/// One panel.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// Title above the panel.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Drawn in order.
    pub series: Vec<Series>,
    /// Behind the series; one unit of each axis in size.
    pub cells: Vec<Cell>,
    /// Above all; moved vertically where they would overlap.
    pub labels: Vec<Label>,
}

impl Panel {
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [left, base] = ORIGIN;
        [left + self.x.share(x) * (RIGHT - left), base - self.y.share(y) * (base - TOP)]
    }

    fn draw(&self, svg: &mut Svg) {
        let ([left, base], middle) = (ORIGIN, (ORIGIN[0] + RIGHT) / 2.0);
        svg.text([&left, &18], "font-size=\"13\"", &self.title);
        for (value, name) in &self.y.ticks {
            let [_, y] = self.place([self.x.range[0], *value]);
            svg.tick(y, [left, RIGHT], "0.3", name);
        }
        let mut line = |text: String| svg.element(text);
        for (value, name) in &self.x.ticks {
            let [x, _] = self.place([*value, self.y.range[0]]);
            line(format!("<path d=\"M{x:.1} {base}v4\" stroke=\"{TEXT}\"/>"));
            let (y, name) = (base + 17.0, escaped(name));
            line(match self.x.ticks.len() > CROWDED {
                true => format!(
                    "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"end\" font-size=\"9\" transform=\"rotate(-45 {x:.1} {y})\">{name}</text>",
                    x + 6.0,
                    y - 4.0
                ),
                false => format!("<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{name}</text>"),
            });
        }
        line(format!("<path d=\"M{left} {TOP}V{base}H{RIGHT}\" fill=\"none\" stroke=\"{TEXT}\"/>"));
        line(format!(
            "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            base + 34.0,
            escaped(&self.x.name)
        ));
        let height = (TOP + base) / 2.0;
        line(format!(
            "<text x=\"14\" y=\"{height}\" text-anchor=\"middle\" transform=\"rotate(-90 14 {height})\">{}</text>",
            escaped(&self.y.name)
        ));
        self.cells.iter().for_each(|cell| self.cell(cell, &mut line));
        for (i, series) in self.series.iter().enumerate() {
            self.series(series, &mut line);
            let (x, y) = (left + (i % 2) as f64 * 180.0, base + 54.0 + (i / 2) as f64 * NAME);
            line(format!("<rect x=\"{x}\" y=\"{}\" width=\"12\" height=\"5\" fill=\"{}\"/>", y - 6.0, series.colour));
            line(format!("<text x=\"{}\" y=\"{y}\">{}</text>", x + 18.0, escaped(&series.name)));
        }
        self.labels(&mut line);
    }

    fn labels(&self, line: &mut impl FnMut(String)) {
        const HEIGHT: f64 = 11.0;
        let mut taken: Vec<[f64; 3]> =
            self.labels.iter().map(|label| self.place(label.place)).map(|[x, y]| [x - 4.0, x + 4.0, y]).collect();
        let mut from_the_top: Vec<&Label> = self.labels.iter().collect();
        from_the_top.sort_by(|a, b| self.place(a.place)[1].total_cmp(&self.place(b.place)[1]));
        for label in from_the_top {
            let [x, y] = self.place(label.place);
            let length = 5.6 * label.text.chars().count() as f64;
            let is_left = x + 7.0 + length > RIGHT;
            let (begin, anchor) = if is_left { (x - 7.0 - length, "end") } else { (x + 7.0, "start") };
            let is_free = |y: f64| {
                let mut others = taken.iter().filter(|[from, to, _]| *from < begin + length && begin < *to);
                others.all(|[.., other]| (other - y).abs() >= HEIGHT - 1.0)
            };
            let places = (0..40).map(|i| y + 3.0 * f64::from((i + 1) / 2) * if i % 2 == 0 { 1.0 } else { -1.0 });
            let free = places.into_iter().find(|y| is_free(*y)).unwrap_or(y);
            taken.push([begin, begin + length, free]);
            let (text, colour, near) = (escaped(&label.text), label.colour, if is_left { x - 7.0 } else { x + 7.0 });
            if (free - y).abs() > HEIGHT / 2.0 {
                line(format!(
                    "<path d=\"M{x:.1} {y:.1}L{near:.1} {free:.1}\" stroke=\"{colour}\" stroke-opacity=\"0.6\"/>"
                ));
            }
            let y = free + 3.5;
            line(format!(
                "<text x=\"{near:.1}\" y=\"{y:.1}\" font-size=\"10\" fill=\"{colour}\" text-anchor=\"{anchor}\">{text}</text>"
            ));
        }
    }

    fn cell(&self, cell: &Cell, line: &mut impl FnMut(String)) {
        let [x, y] = cell.place;
        let ([left, top], [right, bottom]) = (self.place([x - 0.5, y + 0.5]), self.place([x + 0.5, y - 0.5]));
        line(format!(
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\" fill-opacity=\"{:.2}\"/>",
            right - left - 2.0,
            bottom - top - 2.0,
            COLOURS[0],
            0.05 + 0.35 * cell.shade
        ));
        let (middle, height) = ((left + right) / 2.0 - 1.0, (top + bottom) / 2.0 + 3.0);
        line(format!(
            "<text x=\"{middle:.1}\" y=\"{height:.1}\" text-anchor=\"middle\">{}</text>",
            escaped(&cell.text)
        ));
    }

    fn series(&self, series: &Series, line: &mut impl FnMut(String)) {
        let finite = series.points.iter().filter(|point| point.iter().all(|v| v.is_finite()));
        let places: Vec<[f64; 2]> = finite.map(|point| self.place(*point)).collect();
        if series.style != Style::Dots {
            let path: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1} {y:.1}")).collect();
            let dashes = if series.style == Style::Dashed { " stroke-dasharray=\"5 4\"" } else { "" };
            line(format!(
                "<path d=\"M{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.8\"{dashes}/>",
                path.join("L"),
                series.colour
            ));
        }
        if series.style != Style::Dashed {
            for [x, y] in places {
                line(format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\" fill=\"{}\"/>", series.colour));
            }
        }
    }
}

/// Panels side by side.
pub fn svg(title: &str, panels: &[Panel]) -> String {
    let rows = panels.iter().map(|panel| panel.series.len().div_ceil(2)).max().unwrap_or(0);
    let height = PANEL[1] + NAME * rows.saturating_sub(NAMES_FIT) as f64;
    let mut svg = Svg::new(title, PANEL[0] * panels.len() as f64, height);
    for (i, panel) in panels.iter().enumerate() {
        svg.element(format_args!("<g transform=\"translate({} 0)\">", PANEL[0] * i as f64));
        panel.draw(&mut svg);
        svg.element("</g>");
    }
    svg.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of texts of 10 px, from the top.
    fn heights(places: &[[f64; 2]]) -> Vec<f64> {
        let label = |place: &[f64; 2]| Label { place: *place, text: "label".to_string(), colour: COLOURS[0] };
        let axis = || Axis::linear("", [0.0, 10.0], &[]);
        let panel = Panel { x: axis(), y: axis(), labels: places.iter().map(label).collect(), ..Panel::default() };
        let drawn = svg("", &[panel]);
        let texts = drawn.lines().filter(|line| line.ends_with(">label</text>"));
        texts.map(|text| text.split("y=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()).collect()
    }

    #[test]
    fn names_are_escaped() {
        let name = || "if(s <= 1 & 2)".to_string();
        let axis = || Axis { name: name(), ..Axis::linear("", [0.0, 1.0], &[]) };
        let series = Series { name: name(), colour: COLOURS[0], style: Style::Line, points: Vec::new() };
        let panel = Panel { title: name(), x: axis(), y: axis(), series: vec![series], ..Panel::default() };
        let drawn = svg(&name(), &[panel]);
        assert_eq!((drawn.matches("if(s &lt;= 1 &amp; 2)").count(), drawn.matches("<=").count()), (5, 0), "{drawn}");
    }

    #[test]
    fn labels_do_not_overlap_and_stay_beside_their_points() {
        let crowded = heights(&[[5.0, 5.0], [5.0, 4.9], [5.0, 5.1], [5.2, 5.0]]);
        assert_eq!(crowded.len(), 4);
        let mut sorted = crowded.clone();
        sorted.sort_by(f64::total_cmp);
        assert!(sorted.windows(2).all(|pair| pair[1] - pair[0] >= 9.9), "{crowded:?}");
        let free = heights(&[[1.0, 8.0], [1.0, 2.0]]);
        let [y, other] = [8.0, 2.0].map(|y| ORIGIN[1] - y / 10.0 * (ORIGIN[1] - TOP) + 3.5);
        assert!((free[0] - y).abs() < 0.1 && (free[1] - other).abs() < 0.1, "{free:?}");
    }
}
