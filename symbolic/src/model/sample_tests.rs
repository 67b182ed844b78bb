//! Samples agree with the formulas.
#![allow(clippy::unwrap_used)]
use crate::{Model, Slopes};

#[test]
fn samples_evaluate_the_formulas() {
    let text = "name = \"s\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\na = { start = 1.0 }\n\
        [constants]\nc = 2.0\n[model]\nintensity = \"a * x^2 + c * y\"\ndomain = \"x < 3\"\nnoise = \"1 + intensity\"\n";
    let model = Model::from_toml(text).unwrap();
    let samples = model.samples(&[vec![2.0, 1.0], vec![3.0, 0.5]], &[5.0], &[7.0]);
    assert_eq!((&samples[0].entries[..], samples[0].inside), (&[(27.0, Some(28.0))][..], true));
    assert_eq!((&samples[1].entries[..], samples[1].inside), (&[(48.5, Some(49.5))][..], false));
    let plain = Model::from_toml(&text.replace("domain = \"x < 3\"\nnoise = \"1 + intensity\"\n", "")).unwrap();
    let sample = plain.samples(&[vec![3.0, 0.5]], &[5.0], &[7.0]).remove(0);
    assert!(sample.inside && sample.entries[0].1.is_none());
    let two = text
        .replace("[\"phi\"]", "[\"one\", \"two\"]")
        .replace("\"a * x", "\"[2, 3] * a * x")
        .replace("+ c * y", "+ [y, 0]");
    let two = two.replace("[model]\n", "[model]\nobserved = \"[one, two]\"\n");
    let sample = Model::from_toml(&two).unwrap().samples(&[vec![2.0, 1.0]], &[5.0], &[7.0]).remove(0);
    assert_eq!(sample.entries, [(41.0, Some(42.0)), (60.0, Some(61.0))]);
}

/// A formula that subtracts from the prediction, as `intensity - black` does, reads the value compared with the pixel:
/// the mean over its area, with any correction.
#[test]
fn noise_of_a_difference_reads_the_mean_over_the_pixel() {
    let text = "name = \"s\"\ncoordinates = [\"x\", \"y\"]\nchannels = [\"phi\"]\n[parameters]\na = { start = 1.0 }\n\
        v = { start = 2.0 }\n[constants]\nblack = 3.0\n[model]\nintensity = \"v + a * x^2\"\n\
        noise = \"1 + 0.5 * (intensity - black)\"\nquadrature = 2\n";
    for (points, wanted) in [("1", 20.0), ("2", 20.0 + 4.0 / 12.0)] {
        let model = Model::from_toml(&text.replace("quadrature = 2", &format!("quadrature = {points}"))).unwrap();
        let sampled = |model: &Model| model.samples(&[vec![2.0, 1.0]], &[4.0, 4.0], &[3.0]).remove(0).entries[0];
        let (mean, variance) = sampled(&model);
        assert!((mean - wanted).abs() < 1e-12, "{points}: {mean}");
        assert!((variance.unwrap() - (1.0 + 0.5 * (wanted - 3.0))).abs() < 1e-12, "{points}: {variance:?}");
        // The value of a channel is unknown without a picture.
        let corrected = sampled(&model.corrected(Slopes::Centre));
        assert!(corrected.0.is_nan() && corrected.1.unwrap().is_nan(), "{points}: {corrected:?}");
    }
}
