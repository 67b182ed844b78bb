//! The thesis' Figure 6.1 as an SVG: four bars of Maple's and four of ours for each subset.
//!
//! Every colour is one that can be read on white and on black, for nothing says on which the figure is shown.

use std::fmt::Write;

/// What a bar stands for, and its colour: Maple's are orange, ours are blue.
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
const TEXT: &str = "#767e88";
const WIDTH: u32 = 900;
const HEIGHT: u32 = 450;
/// Where the axes meet, px from the top left.
const ORIGIN: (u32, u32) = (44, 360);
/// Flops at the upper rim, and its height over the axis, px.
const TOP: (u32, u32) = (500, 330);
const GROUP_PX: u32 = 212;
const BAR_PX: u32 = 23;
/// Between Maple's bars and ours.
const GAP_PX: u32 = 8;

fn height(flops: u32) -> f64 {
    f64::from(flops * TOP.1) / f64::from(TOP.0)
}

/// Groups: a name, and the eight heights in the order of the legend.
pub fn svg(groups: &[(&str, [u32; 8])]) -> String {
    let (left, base) = ORIGIN;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" \
         font-family=\"sans-serif\" font-size=\"11\" fill=\"{TEXT}\">\n\
         <title>Flops per pixel of the loops for gradient and Hessian: Maple 9 and isophote</title>\n\
         <text x=\"{left}\" y=\"16\" font-size=\"13\">flops per pixel, thesis-spot, Newton</text>\n"
    );
    let mut line = |text: String| writeln!(svg, "{text}").unwrap();
    for tick in (0..=TOP.0).step_by(100) {
        let y = f64::from(base) - height(tick);
        let right = WIDTH - 4;
        line(format!(
            "<path d=\"M{left} {y:.1}H{right}\" stroke=\"{TEXT}\" stroke-opacity=\"{}\"/>",
            if tick == 0 { "1" } else { "0.3" }
        ));
        line(format!("<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{tick}</text>", left - 6, y + 4.0));
    }
    for (group, (name, values)) in (0..).zip(groups) {
        let start = left + 14 + group * GROUP_PX;
        for (bar, (value, (what, colour))) in (0..).zip(values.iter().zip(BARS)) {
            let x = start + bar * BAR_PX + if bar < 4 { 0 } else { GAP_PX };
            let y = f64::from(base) - height(*value);
            line(format!(
                "<rect x=\"{x}\" y=\"{y:.1}\" width=\"{}\" height=\"{:.1}\" fill=\"{colour}\"><title>{name}: {what}, {value}</title></rect>",
                BAR_PX - 2,
                height(*value)
            ));
            let middle = f64::from(x) + f64::from(BAR_PX - 2) / 2.0;
            line(format!("<text x=\"{middle}\" y=\"{:.1}\" text-anchor=\"middle\">{value}</text>", y - 4.0));
        }
        let middle = start + (8 * BAR_PX + GAP_PX) / 2;
        line(format!("<text x=\"{middle}\" y=\"{}\" font-size=\"14\" text-anchor=\"middle\">{name}</text>", base + 20));
    }
    for (i, (what, colour)) in (0..).zip(BARS) {
        let (x, y) = (left + 14 + (i % 4) * 200, base + 42 + (i / 4) * 24);
        line(format!("<rect x=\"{x}\" y=\"{y}\" width=\"14\" height=\"14\" fill=\"{colour}\"/>"));
        line(format!("<text x=\"{}\" y=\"{}\" font-size=\"12\">{what}</text>", x + 20, y + 11));
    }
    svg + "</svg>\n"
}
