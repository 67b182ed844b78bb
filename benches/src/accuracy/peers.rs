//! Peers on the same conditions: the best of 17 methods of OpenCV, ViSP, photutils, scipy and Cpufit, measured by the
//! prototypes that this bench follows, on 150 frames per condition (±4 %; slow methods 12 to 25 frames, ±10 to 20 %).
//! Excluded: photutils' 0.82 on small_S0, which is below the bound and comes from 12 frames.

/// RMSE/CRLB of the centre by the best peer, and its name; `None`: no method answered.
pub const PEERS: [(&str, Option<(f64, &str)>); 14] = [
    ("S0", Some((1.25, "scipy, rotated Gaussian"))),
    ("S10", Some((1.32, "photutils 2dg"))),
    ("S30", Some((1.09, "scipy, rotated Gaussian"))),
    ("S60", Some((1.30, "photutils 2dg"))),
    ("dark", Some((1.06, "scipy, rotated Gaussian"))),
    ("glareLin", Some((2.06, "OpenCV ellipse of an iso-contour, plane removed"))),
    ("glareLobe", Some((33.0, "the same"))),
    ("occl25", Some((49.0, "ViSP vpDot2"))),
    ("blind40", None),
    ("motion6", Some((1.15, "scipy, rotated Gaussian"))),
    ("defocus2", Some((1.07, "scipy, rotated Gaussian"))),
    ("small_S0", Some((1.12, "scipy, rotated Gaussian"))),
    ("small_S30", Some((1.50, "OpenCV ellipse of an iso-contour"))),
    ("big_S30", Some((1.08, "scipy, rotated Gaussian"))),
];

/// The table cell of a condition; a dash if peers were not measured on it.
pub fn best(condition: &str) -> String {
    match PEERS.iter().find(|(name, _)| *name == condition) {
        Some((_, Some((ratio, who)))) => format!("{ratio} ({who})"),
        Some((_, None)) => "no answer".to_string(),
        None => "–".to_string(),
    }
}
