//! The thesis' Figure 6.1 as an SVG: four bars of Maple's and four of Isophote's for each subset.

use crate::plot::Svg;

/// Meaning and colour of the bars: Maple's are orange, Isophote's are blue.
const BARS: [(&str, &str); 8] = [
    ("Maple 9: separate", "#a85a1c"),
    ("separate, tryhard", "#cf7a2f"),
    ("joint", "#e39b55"),
    ("joint, tryhard", "#edbd86"),
    ("isophote: separate, plain", "#2f68b0"),
    ("separate, optimised", "#4389d8"),
    ("joint, plain", "#70a9ea"),
    ("joint, optimised", "#9fc8f3"),
];
const WIDTH: u32 = 900;
const HEIGHT: u32 = 450;
/// Origin of the axes, px from the top left.
const ORIGIN: (u32, u32) = (44, 360);
/// Flops at the upper rim, and its height above the axis, px.
const TOP: (u32, u32) = (500, 330);
const GROUP_PX: u32 = 212;
const BAR_PX: u32 = 23;
/// Gap between Maple's bars and Isophote's.
const GAP_PX: u32 = 8;

fn height(flops: u32) -> f64 {
    f64::from(flops * TOP.1) / f64::from(TOP.0)
}

/// Groups: a name, and the eight values in the order of the legend.
pub fn svg(groups: &[(&str, [u32; 8])]) -> String {
    let (left, base) = ORIGIN;
    let title = "Flops per pixel of the loops for gradient and Hessian: Maple 9 and isophote";
    let mut svg = Svg::new(title, WIDTH, HEIGHT);
    svg.text([&left, &16], "font-size=\"13\"", "flops per pixel, thesis-spot, Newton");
    for tick in (0..=TOP.0).step_by(100) {
        let across = [f64::from(left), f64::from(WIDTH - 4)];
        svg.tick(f64::from(base) - height(tick), across, if tick == 0 { "1" } else { "0.3" }, tick);
    }
    for (group, (name, values)) in (0..).zip(groups) {
        let start = left + 14 + group * GROUP_PX;
        for (bar, (value, (what, colour))) in (0..).zip(values.iter().zip(BARS)) {
            let x = start + bar * BAR_PX + if bar < 4 { 0 } else { GAP_PX };
            let (y, tall) = (f64::from(base) - height(*value), height(*value));
            let title = format!("<title>{name}: {what}, {value}</title>");
            svg.rect([&x, &format_args!("{y:.1}")], [&(BAR_PX - 2), &format_args!("{tall:.1}")], colour, &title);
            let middle = f64::from(x) + f64::from(BAR_PX - 2) / 2.0;
            svg.text([&middle, &format_args!("{:.1}", y - 4.0)], "text-anchor=\"middle\"", value);
        }
        let middle = start + (8 * BAR_PX + GAP_PX) / 2;
        svg.text([&middle, &(base + 20)], "font-size=\"14\" text-anchor=\"middle\"", name);
    }
    for (i, (what, colour)) in (0..).zip(BARS) {
        let (x, y) = (left + 14 + (i % 4) * 200, base + 42 + (i / 4) * 24);
        svg.rect([&x, &y], [&14, &14], colour, "");
        svg.text([&(x + 20), &(y + 11)], "font-size=\"12\"", what);
    }
    svg.finish()
}
