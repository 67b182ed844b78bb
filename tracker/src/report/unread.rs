//! Keys of a camera's document that change nothing, because no formula of the model reads them.

use isophote_symbolic::{Diagnostic, Model, Severity, Span};

use crate::options::TrackerOptions;

/// Example of a document's noise formula.
const NOISE: &str = "`noise = \"read_noise^2 + 1/12 + gain * max(intensity - black, 0)\"`";

impl TrackerOptions {
    /// A warning for each key of the camera's document that neither a formula of the model nor fits or poses use.
    pub fn unread(&self, model: &Model) -> Vec<Diagnostic> {
        let unused = model.unused();
        let is_unused = |name: &str| unused.iter().any(|warning| warning.key == format!("constants.{name}"));
        let reads = |name: &str| model.constant(name).is_some() && !is_unused(name);
        let camera = &self.camera;
        let has_rows = model.has_noise() && model.coordinates().len() > 1;
        let is_posed = self.target.is_some() || model.roles().iter().any(|roles| !roles.position.is_empty());
        let declare =
            |names: &str| format!("declare {names} among the constants of the model and read it in a formula: {NOISE}");
        let mut warnings = Vec::new();
        let mut warn = |key: &str, is_given: bool, is_read: bool, help: String| {
            let message =
                format!("no formula of the model `{}` reads the camera's `{key}`: it changes nothing", model.name());
            let warning = Diagnostic::error("", "unused", key, Span::default(), message).help(help);
            let warning = Diagnostic { severity: Severity::Warning, key: format!("camera.{key}"), ..warning };
            warnings.extend((is_given && !is_read).then_some(warning));
        };
        warn("black", camera.black != 0.0, camera.response.is_some() || reads("black"), declare("`black`"));
        let in_noise = reads("gain") || reads("read_noise") && camera.read_noise_e.is_some();
        let in_rows = has_rows && camera.row_noise_e.is_some();
        warn(
            "electrons_per_dn",
            camera.electrons_per_dn.is_some(),
            in_noise || in_rows,
            declare("`gain` (DN an electron)"),
        );
        let read_noise = match (reads("read_noise"), camera.electrons_per_dn) {
            (true, None) => "state `electrons_per_dn` as well: formulas read `read_noise` in DN".to_string(),
            _ => declare("`read_noise` (DN)"),
        };
        let is_read = reads("read_noise") && camera.electrons_per_dn.is_some();
        warn("read_noise_e", camera.read_noise_e.is_some(), is_read, read_noise);
        let noisy = format!("offsets of rows are weighed against the noise of pixels: give the model a {NOISE}");
        warn("row_noise_e", camera.row_noise_e.is_some(), has_rows, noisy);
        let censored =
            "give the model `saturated = \"censored\"`: hot pixels are told from clipped ones there".to_string();
        warn("defects", camera.defects.is_some(), model.defects().is_some(), censored);
        let posed = "a lens is needed for poses: state a target, or fit a model whose formulas read `fx`".to_string();
        warn("intrinsics", camera.intrinsics.is_some(), is_posed || reads("fx"), posed);
        warnings
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::camera::{Camera, Distortion, Intrinsics};
    use isophote_frame::CameraResponse;

    fn keys(model: &str, camera: Camera) -> Vec<String> {
        let options = TrackerOptions { camera, ..TrackerOptions::default() };
        options.unread(&Model::from_toml(model).unwrap()).into_iter().map(|warning| warning.key).collect()
    }

    #[test]
    fn unread_keys_give_warnings() {
        let [noisy, even] =
            [include_str!("../../../models/moffat.toml"), include_str!("../../../models/gaussian.toml")];
        let camera = Camera {
            black: 200.0,
            electrons_per_dn: Some(20.0),
            read_noise_e: Some(15.0),
            row_noise_e: Some(2.0),
            defects: Some(0.01),
            saturation: Some(4000.0),
            ..Camera::default()
        };
        let all =
            ["camera.black", "camera.electrons_per_dn", "camera.read_noise_e", "camera.row_noise_e", "camera.defects"];
        assert_eq!(keys(even, camera.clone()), all);
        assert!(keys(noisy, Camera { defects: None, ..camera.clone() }).is_empty());
        // A response subtracts the black level.
        let response = Some(CameraResponse { gamma: 1.0, gains: None });
        assert_eq!(keys(even, Camera { response, ..camera.clone() }), all[1..]);
        // The constant is declared, but not all of its inputs are given.
        let half = Camera { read_noise_e: Some(15.0), ..Camera::default() };
        assert_eq!(keys(noisy, half), ["camera.read_noise_e"]);
        // A constant that no formula reads has no effect.
        let idle = even.replace("[definitions]", "[constants]\nblack = 0.0\n[definitions]");
        assert_eq!(keys(&idle, Camera { black: 7.0, ..Camera::default() }), all[..1]);
        let (model, coefficients, covariance) = (Distortion::None, Vec::new(), None);
        let (width, height, fx, fy, cx, cy) = (640, 480, 500.0, 500.0, 319.5, 239.5);
        let lens = Intrinsics { width, height, fx, fy, cx, cy, model, coefficients, covariance };
        let lens = Camera { intrinsics: Some(lens), ..Camera::default() };
        assert_eq!(keys(even, lens.clone()), ["camera.intrinsics"]);
        assert!(keys(include_str!("../../../models/three-spots-pose.toml"), lens).is_empty());
        assert!(keys(even, Camera { saturation: Some(253.0), ..Camera::default() }).is_empty());
    }
}
