//! Parser of OpenCV and ROS calibration files: text in, [`Intrinsics`] out.
//!
//! OpenCV's `FileStorage` writes YAML whose first line is `%YAML:1.0` and whose matrices carry the tag `!!opencv-matrix`;
//! ROS's `camera_info` has the same matrices without a tag. YAML itself is read by saphyr-parser, event by event; anchors
//! and aliases are refused, depth and size are bounded.

use std::collections::BTreeMap;

use saphyr_parser::{Event, Parser};

use super::{Distortion, Intrinsics, IntrinsicsError};

/// Why a calibration file is rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// The file is too long.
    #[error("a calibration file has at most {TEXT_MAX} bytes, this one {0}")]
    TooLong(usize),
    /// Not the YAML of a calibration file.
    #[error("not a calibration file of OpenCV or ROS: {0}")]
    Syntax(String),
    /// A key is missing.
    #[error("the calibration file has no `{0}`")]
    Missing(&'static str),
    /// A key has an invalid value.
    #[error("`{key}` of the calibration file {wanted}")]
    Wrong {
        /// The key.
        key: &'static str,
        /// The expected value.
        wanted: &'static str,
    },
    /// Invalid intrinsics.
    #[error(transparent)]
    Intrinsics(#[from] IntrinsicsError),
}

/// Largest file, bytes.
const TEXT_MAX: usize = 256 * 1024;
/// Largest nesting depth.
const DEPTH_MAX: usize = 16;
/// Keys of K and of the distortion coefficients in OpenCV's samples, its stereo calibration and ROS.
const MATRICES: [&str; 4] = ["camera_matrix", "cameraMatrix", "K", "Camera_Matrix"];
const COEFFICIENTS: [&str; 4] = ["distortion_coefficients", "distCoeffs", "D", "Distortion_Coefficients"];
const WIDTHS: [&str; 2] = ["image_width", "image_Width"];
const HEIGHTS: [&str; 2] = ["image_height", "image_Height"];
/// Keys of the distortion model. OpenCV's `flags` cannot tell a fisheye calibration: `fisheye::CALIB_…` shares bits with others.
const MODELS: [&str; 3] = ["distortion_model", "camera_model", "model"];

/// A value of the file.
enum Value {
    Text(String),
    List(Vec<Value>),
    Table(BTreeMap<String, Value>),
}

impl Value {
    fn number(&self) -> Option<f64> {
        match self {
            Value::Text(text) => text.trim().parse().ok(),
            _ => None,
        }
    }

    /// Numbers of a matrix (`data`), a list, or a list of lists, row by row.
    fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Value::Table(table) => table.get("data")?.numbers(),
            Value::List(list) => {
                let rows: Option<Vec<Vec<f64>>> =
                    list.iter().map(|value| value.number().map(|n| vec![n]).or_else(|| value.numbers())).collect();
                Some(rows?.concat())
            }
            Value::Text(_) => None,
        }
    }
}

impl Intrinsics {
    /// Reads OpenCV's YAML (or ROS's `camera_info`): `camera_matrix`, `distortion_coefficients`, `image_width`,
    /// `image_height`, and `distortion_model` where there is one. Without one, four or five coefficients are `plumb_bob`,
    /// more are `rational` (beyond the eighth they must be 0: thin prisms and tilted sensors are not modelled), none or
    /// nothing but zeros is `none`.
    ///
    /// # Errors
    /// When the text is no such file, lacks one of these keys, or has invalid numbers.
    pub fn from_opencv_yaml(text: &str) -> Result<Intrinsics, CalibrationError> {
        let table = read(text)?;
        let find = |names: &[&str]| names.iter().find_map(|name| table.get(*name));
        let matrix = find(&MATRICES).ok_or(CalibrationError::Missing("camera_matrix"))?;
        let Some([fx, skew, cx, zero, fy, cy, 0.0, 0.0, 1.0]) =
            matrix.numbers().and_then(|numbers| <[f64; 9]>::try_from(numbers).ok())
        else {
            return Err(CalibrationError::Wrong {
                key: "camera_matrix",
                wanted: "must be 3×3 with the last row 0 0 1",
            });
        };
        if skew != 0.0 || zero != 0.0 {
            return Err(CalibrationError::Wrong { key: "camera_matrix", wanted: "must have no skew" });
        }
        let side = |names: &[&str], name| {
            let value = find(names).or_else(|| of_size(&table, names)).ok_or(CalibrationError::Missing(name))?;
            let wrong = CalibrationError::Wrong { key: name, wanted: "must be a whole number of pixels" };
            value.number().filter(|n| *n >= 1.0 && *n <= 1e6 && n.fract() == 0.0).map(|n| n as u32).ok_or(wrong)
        };
        let (width, height) = (side(&WIDTHS, "image_width")?, side(&HEIGHTS, "image_height")?);
        let coefficients = match find(&COEFFICIENTS) {
            None => Vec::new(),
            Some(value) => value.numbers().ok_or(CalibrationError::Wrong {
                key: "distortion_coefficients",
                wanted: "must be a matrix of numbers",
            })?,
        };
        let named = match find(&MODELS) {
            Some(Value::Text(name)) => Some(name.as_str()),
            _ => None,
        };
        let (model, coefficients) = lens(named, coefficients)?;
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy, model, coefficients, covariance: None };
        intrinsics.check()?;
        Ok(intrinsics)
    }
}

/// `image_size: [640, 480]`, as some samples write it.
fn of_size<'a>(table: &'a BTreeMap<String, Value>, names: &[&str]) -> Option<&'a Value> {
    match table.get("image_size")? {
        Value::List(list) => list.get(usize::from(names == HEIGHTS)),
        _ => None,
    }
}

fn lens(named: Option<&str>, mut coefficients: Vec<f64>) -> Result<(Distortion, Vec<f64>), CalibrationError> {
    let wrong = |wanted| CalibrationError::Wrong { key: "distortion_coefficients", wanted };
    let model = match named {
        Some("fisheye" | "equidistant" | "kannala_brandt") => Distortion::Fisheye,
        Some("rational_polynomial" | "rational") => Distortion::Rational,
        Some("plumb_bob" | "brown_conrady" | "pinhole" | "radtan") | None => match coefficients.len() {
            _ if coefficients.iter().all(|c| *c == 0.0) => Distortion::None,
            4 | 5 => Distortion::PlumbBob,
            _ => Distortion::Rational,
        },
        Some(_) => {
            return Err(CalibrationError::Wrong {
                key: "distortion_model",
                wanted: "must be plumb_bob, rational_polynomial, fisheye or equidistant",
            });
        }
    };
    match model {
        Distortion::None => coefficients.clear(),
        Distortion::Rational if coefficients.len() > 8 => {
            if coefficients[8..].iter().any(|c| *c != 0.0) {
                return Err(wrong(
                    "has a thin prism or a tilted sensor (more than 8 coefficients), which is not modelled",
                ));
            }
            coefficients.truncate(8);
        }
        _ => {}
    }
    Ok((model, coefficients))
}

/// The top-level table of the first document.
fn read(text: &str) -> Result<BTreeMap<String, Value>, CalibrationError> {
    if text.len() > TEXT_MAX {
        return Err(CalibrationError::TooLong(text.len()));
    }
    let text = text.trim_start_matches('\u{feff}');
    // OpenCV's directive `%YAML:1.0` is not valid YAML.
    let body = match text.strip_prefix("%YAML:") {
        Some(rest) => rest.split_once('\n').map_or("", |(_, body)| body),
        None => text,
    };
    let mut reader = Reader { parser: Parser::new_from_str(body), depth: 0 };
    loop {
        match reader.next()? {
            Event::StreamStart | Event::DocumentStart(_) | Event::Nothing => {}
            Event::MappingStart(0, _) => return reader.table(),
            _ => return Err(CalibrationError::Syntax("it holds no keys".into())),
        }
    }
}

struct Reader<'a> {
    parser: Parser<'a, saphyr_parser::StrInput<'a>>,
    depth: usize,
}

impl<'a> Reader<'a> {
    fn next(&mut self) -> Result<Event<'a>, CalibrationError> {
        match self.parser.next_event() {
            Some(Ok((event, _))) => Ok(event),
            Some(Err(error)) => Err(CalibrationError::Syntax(error.to_string())),
            None => Err(CalibrationError::Syntax("it ends too early".into())),
        }
    }

    fn table(&mut self) -> Result<BTreeMap<String, Value>, CalibrationError> {
        let mut table = BTreeMap::new();
        loop {
            let key = match self.next()? {
                Event::MappingEnd => return Ok(table),
                Event::Scalar(key, ..) => key.to_string(),
                _ => return Err(CalibrationError::Syntax("a key is not a word".into())),
            };
            let event = self.next()?;
            let value = self.value(event)?;
            if table.insert(key.clone(), value).is_some() {
                return Err(CalibrationError::Syntax(format!("the key `{key}` stands twice")));
            }
        }
    }

    fn value(&mut self, event: Event<'a>) -> Result<Value, CalibrationError> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(CalibrationError::Syntax("it is nested too deeply".into()));
        }
        let value = match event {
            Event::Scalar(text, _, 0, _) => Value::Text(text.into_owned()),
            Event::MappingStart(0, _) => Value::Table(self.table()?),
            Event::SequenceStart(0, _) => {
                let mut list = Vec::new();
                loop {
                    match self.next()? {
                        Event::SequenceEnd => break Value::List(list),
                        event => list.push(self.value(event)?),
                    }
                }
            }
            _ => return Err(CalibrationError::Syntax("anchors and aliases are not read".into())),
        };
        self.depth -= 1;
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const OPENCV: &str = "%YAML:1.0\n---\ncalibration_time: \"Sat 21 Nov 2026\"\nimage_width: 640\nimage_height: 480\nflags: 0\n\
        camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 5.3591575e+02, 0., 3.4228315e+02, 0.,\n\
        \x20      5.3591602e+02, 2.3557083e+02, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n\
        \x20  dt: d\n   data: [ -2.6637e-01, -3.8588e-02, 1.7831e-03, -2.8122e-04, 2.3839e-01 ]\navg_reprojection_error: 3.9e-01\n";

    #[test]
    fn opencv_file_is_read() {
        let intrinsics = Intrinsics::from_opencv_yaml(OPENCV).unwrap();
        assert_eq!(
            (intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.cy),
            (640, 480, 535.91575, 235.57083)
        );
        assert_eq!(intrinsics.model, Distortion::PlumbBob);
        assert_eq!(intrinsics.coefficients, [-0.26637, -0.038588, 0.0017831, -0.00028122, 0.23839]);
        let fisheye = OPENCV.replace("flags: 0", "distortion_model: fisheye").replace("-2.6637e-01, ", "");
        assert_eq!(Intrinsics::from_opencv_yaml(&fisheye).unwrap().model, Distortion::Fisheye);
        let zeros =
            OPENCV.replace("-2.6637e-01, -3.8588e-02, 1.7831e-03, -2.8122e-04, 2.3839e-01", "0., 0., 0., 0., 0.");
        assert_eq!(Intrinsics::from_opencv_yaml(&zeros).unwrap().model, Distortion::None);
    }

    #[test]
    fn ros_file_is_read() {
        let text = "image_width: 1280\nimage_height: 720\ncamera_name: left\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
            data: [900, 0, 640, 0, 901, 360, 0, 0, 1]\ndistortion_model: rational_polynomial\ndistortion_coefficients:\n  \
            rows: 1\n  cols: 8\n  data: [0.1, 0.2, 0, 0, 0.3, 0.4, 0.5, 0.6]\n";
        let intrinsics = Intrinsics::from_opencv_yaml(text).unwrap();
        assert_eq!((intrinsics.model, intrinsics.fy, intrinsics.height), (Distortion::Rational, 901.0, 720));
    }

    #[test]
    fn other_files_are_rejected_with_a_reason() {
        let error_message = |text: &str| Intrinsics::from_opencv_yaml(text).unwrap_err().to_string();
        assert!(error_message("{\"fx\": 1}").contains("no `camera_matrix`"));
        assert!(error_message("").contains("not a calibration file"));
        assert!(error_message(&OPENCV.replace("0., 0., 1. ]", "0., 0., 2. ]")).contains("last row 0 0 1"));
        assert!(error_message(&OPENCV.replace("image_width: 640", "image_width: 640.5")).contains("whole number"));
        assert!(error_message(&OPENCV.replace("image_height: 480\n", "")).contains("no `image_height`"));
        assert!(error_message(&OPENCV.replace("-2.6637e-01, -3.8588e-02, ", "")).contains("8 (k1"));
        assert!(error_message("a: &x [1]\nb: *x\n").contains("anchors"));
        assert!(error_message(&format!("a: {}{}", "[".repeat(40), "]".repeat(40))).contains("nested"));
        assert!(error_message(&" ".repeat(TEXT_MAX + 1)).contains("at most"));
        let tilted = OPENCV.replace("2.3839e-01 ]", "0.2, 0, 0, 0, 0, 0, 0, 0, 0.01, 0 ]");
        assert!(error_message(&tilted).contains("tilted sensor"));
    }
}
