#![allow(clippy::unwrap_used)]
use isophote_frame::Plane;

use super::*;

const SIZE: [usize; 2] = [64, 48];
const BLACK: f64 = 16.0;
const NOISE_DN: f64 = 1.5;

/// Uniform numbers in −1 … 1 from a linear congruential generator.
struct Uniform(u64);

impl Uniform {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Gains of pixels with a scatter of 2 %.
fn gains() -> Vec<f64> {
    let mut uniform = Uniform(5);
    (0..SIZE[0] * SIZE[1]).map(|_| 1.0 + 0.02 * 3f64.sqrt() * uniform.next()).collect()
}

fn camera(gamma: f64) -> Response {
    Response::new(BLACK, Some(255.0), &CameraResponse { gamma, gains: None }).unwrap()
}

/// A field at this light level that is brighter on the left, as a camera of that gamma reads it.
fn field(gamma: f64, light: f64, gains: &[f64], uniform: &mut Uniform) -> Frame {
    let camera = camera(gamma);
    let pixel = |(place, gain): (usize, &f64)| {
        let even = light * (1.0 - 0.1 * (place % SIZE[0]) as f64 / SIZE[0] as f64);
        (camera.value(even * gain + NOISE_DN * uniform.next()) + 0.5).clamp(0.0, 255.0) as u8
    };
    let pixels = gains.iter().enumerate().map(pixel).collect();
    Frame::new(&SIZE, vec![Plane::owned(PixelFormat::U8, pixels, SIZE[0])]).unwrap()
}

fn measure(black: Option<f64>, gamma: f64, lights: &[f64]) -> Result<MeasuredResponse, ResponseFault> {
    let mut measurement = ResponseMeasurement::new(ResponseOptions { black, saturation: Some(255.0) });
    let mut uniform = Uniform(7);
    for light in lights {
        // In units other than the camera's.
        measurement.add(light / 30.0, &field(gamma, *light, &gains(), &mut uniform))?;
    }
    measurement.finish()
}

#[test]
fn gamma_is_recovered() {
    let lights = [40.0, 60.0, 90.0, 120.0, 180.0, 240.0 / 1.15];
    for (black, gamma) in [0.45, 1.0, 1.6].into_iter().flat_map(|gamma| [(Some(BLACK), gamma), (None, gamma)]) {
        let found = measure(black, gamma, &lights).unwrap_or_else(|fault| panic!("{fault}"));
        let near = |[value, sigma]: [f64; 2], truth: f64, most: f64| {
            assert!((value - truth).abs() < 4.0 * sigma + 1e-3 * truth && sigma < most, "{gamma} {black:?}: {found:?}");
        };
        near(found.gamma, gamma, 0.02 * gamma);
        near(found.black, BLACK, 0.5);
        assert!(found.off < 0.003 && found.lights == 6 && found.frames == 6 && found.saturation == 255.0);
    }
}

#[test]
fn gains_are_separated_from_an_uneven_field() {
    let (truth, mut uniform) = (gains(), Uniform(9));
    let mut measurement = GainMeasurement::new(camera(0.45));
    for light in [40.0, 80.0, 160.0, 160.0, 160.0, 160.0] {
        measurement.add(&field(0.45, light, &truth, &mut uniform));
    }
    let found = measurement.finish().unwrap();
    let [value, sigma] = found.nonuniformity;
    assert!((value - 0.02).abs() < 4.0 * sigma && found.left_out == 0, "{value} {sigma}");
    let map = found.map.unwrap();
    let off = |(step, truth): (&i8, &f64)| (1.0 + map.step * f64::from(*step) - truth).powi(2);
    let off = (map.steps.iter().zip(&truth).map(off).sum::<f64>() / truth.len() as f64).sqrt();
    // A tenth of the pixels' scatter, consistent with the stated error.
    assert!(off < 0.0035 && (0.8..1.25).contains(&(off / found.sigma)), "{off} {}", found.sigma);

    // Equal pixels, one of them dead.
    let mut alike = vec![1.0; truth.len()];
    alike[100] = 0.2;
    let mut measurement = GainMeasurement::new(camera(0.45));
    (0..6).for_each(|_| measurement.add(&field(0.45, 160.0, &alike, &mut uniform)));
    let found = measurement.finish().unwrap();
    assert!(found.map.is_none() && found.nonuniformity[1] < 0.003, "{found:?}");
    let mut measurement = GainMeasurement::new(camera(0.45));
    let one_dead: Vec<f64> = truth.iter().enumerate().map(|(at, gain)| if at == 100 { 0.2 } else { *gain }).collect();
    (0..6).for_each(|_| measurement.add(&field(0.45, 160.0, &one_dead, &mut uniform)));
    let found = measurement.finish().unwrap();
    assert_eq!((found.left_out, found.map.map(|map| map.steps[100])), (1, Some(0)));
}

#[test]
fn unsuitable_fields_are_refused() {
    let error_message = |gamma: f64, lights: &[f64]| measure(Some(BLACK), gamma, lights).unwrap_err().to_string();
    assert!(error_message(0.45, &[50.0, 200.0]).contains("in 2 light(s); it takes 3 and more"));
    assert_eq!(measure(None, 0.45, &[50.0, 100.0, 200.0]), Err(ResponseFault::Lights { found: 3, needed: 4 }));
    assert!(error_message(0.45, &[50.0, 60.0, 70.0]).contains("1.40 times the weakest"));
    assert!(error_message(0.45, &[50.0, 100.0, 400.0]).contains("clipped at 255; take less light"));
    assert!(error_message(1.0, &[-30.0, 100.0, 200.0]).contains("-1 is none"));
    let mut uniform = Uniform(7);
    let mut measurement = ResponseMeasurement::new(ResponseOptions { black: Some(60.0), saturation: Some(255.0) });
    let mut add = |light: f64, value: f64| measurement.add(light, &field(1.0, value, &gains(), &mut uniform));
    assert!(add(1.0, 30.0).is_ok() && add(2.0, 60.0).is_ok() && add(4.0, 120.0).is_ok());
    let small = Frame::new(&[8, 8], vec![Plane::owned(PixelFormat::U8, vec![7; 64], 8)]).unwrap();
    let fractions = Frame::new(&[1, 1], vec![Plane::owned(PixelFormat::F32, vec![0; 4], 1)]).unwrap();
    assert!(
        measurement.add(1.0, &small).unwrap_err().to_string().contains("64 × 48 px in 1 plane(s) of U8, then 8 × 8 px")
    );
    let mut of_fractions = ResponseMeasurement::new(ResponseOptions { black: Some(0.0), saturation: None });
    assert_eq!(of_fractions.add(1.0, &fractions), Err(ResponseFault::Fractions));
    // A black level above the values, and a slightly wrong one.
    assert!(matches!(measurement.finish(), Err(ResponseFault::Black(..))));
    let mut measurement = ResponseMeasurement::new(ResponseOptions { black: Some(0.0), saturation: Some(255.0) });
    for light in [10.0, 40.0, 80.0, 160.0] {
        measurement.add(light, &field(1.0, light, &gains(), &mut uniform)).unwrap();
    }
    assert!(matches!(measurement.finish(), Err(ResponseFault::Crooked { .. })));
}
