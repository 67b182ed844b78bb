//! The difference of every pixel of a plane from the median of its neighbours: location and scatter over all frames.

use isophote_frame::Frame;
use isophote_jit::{PixelFormat, PlaneView};

/// With fewer sound neighbours all of them are used.
const SOUND_MIN: usize = 3;

/// Statistics of the differences, row by row.
pub(super) struct Contrast {
    pub size: [usize; 2],
    /// Distance to the next pixel of the same kind: 2 in a mosaic.
    pub spacing: usize,
    /// The mean of the middle half of the differences, DN.
    pub location: Vec<f64>,
    /// Half the distance between the quantiles of 16 and 84 %, DN.
    pub scatter: Vec<f64>,
    /// ln of the variance; −∞ for zero.
    pub variance_ln: Vec<f64>,
    /// Pixels that are not finite in most frames.
    pub absent: Vec<bool>,
    /// Scatter of a uniform picture by rounding, DN.
    pub rounding: f64,
    pub frames: usize,
}

impl Contrast {
    /// Computes one plane of some frames, of their first slices, without known defects.
    pub fn of(frames: &[Frame], plane: usize, spacing: usize) -> Contrast {
        let [width, height, ..] = frames.first().map_or([0; 4], Frame::sides);
        let views: Vec<_> = frames.iter().map(|frame| frame.plane_view(plane)).collect();
        let at = |pixel: usize| [pixel % width, pixel / width];
        // Floating-point formats may hold whole numbers as well.
        let is_whole = |view: &PlaneView| {
            let is_whole = |[x, y]: [usize; 2]| {
                let value = view.pixel(x, y);
                !value.is_finite() || value.fract() == 0.0
            };
            matches!(view.format(), PixelFormat::U8 | PixelFormat::U16) || (0..width * height).map(at).all(is_whole)
        };
        let is_absent = |pixel: usize| {
            let [x, y] = at(pixel);
            2 * views.iter().filter(|view| view.pixel(x, y).is_finite()).count() < views.len()
        };
        let mut contrast = Contrast {
            size: [width, height],
            spacing,
            location: vec![0.0; width * height],
            scatter: vec![0.0; width * height],
            variance_ln: vec![f64::NEG_INFINITY; width * height],
            absent: (0..width * height).map(is_absent).collect(),
            // The variances of a pixel and of the median of eight.
            rounding: if views.iter().all(is_whole) { (1.25_f64 / 12.0).sqrt() } else { 0.0 },
            frames: frames.len(),
        };
        let nothing = vec![false; width * height];
        contrast.compare(frames, plane, &nothing, |_| true);
        contrast
    }

    /// Recomputes the neighbourhoods changed between two sets of defects, `before` and `known`: defects are not used as
    /// neighbours while there are enough others.
    pub fn renew(&mut self, frames: &[Frame], plane: usize, before: &[bool], known: &[bool]) {
        let is_new: Vec<bool> =
            (0..known.len()).map(|pixel| self.around(pixel).any(|near| before[near] != known[near])).collect();
        self.compare(frames, plane, known, |pixel| is_new[pixel]);
    }

    fn compare(&mut self, frames: &[Frame], plane: usize, known: &[bool], is_wanted: impl Fn(usize) -> bool) {
        let [width, height] = self.size;
        let views: Vec<_> = frames.iter().map(|frame| frame.plane_view(plane)).collect();
        let mut differences = Vec::with_capacity(frames.len());
        for pixel in (0..width * height).filter(|pixel| is_wanted(*pixel)) {
            let position = [pixel % width, pixel / width];
            let all = || near(position, self.size, self.spacing, 1);
            let mut around: Vec<[usize; 2]> = all().filter(|[x, y]| !known[y * width + x]).collect();
            if around.len() < SOUND_MIN {
                around = all().collect();
            }
            differences.clear();
            differences.extend(views.iter().map(|view| {
                let (mut values, mut count) = ([0.0; 8], 0);
                for value in around.iter().map(|[x, y]| view.pixel(*x, *y)).filter(|value| value.is_finite()) {
                    values[count] = value;
                    count += 1;
                }
                let middle = if count > 0 { median(&mut values[..count]) } else { f64::NAN };
                view.pixel(position[0], position[1]) - middle
            }));
            differences.retain(|difference| difference.is_finite());
            self.take(pixel, &mut differences);
        }
    }

    fn take(&mut self, pixel: usize, differences: &mut [f64]) {
        let n = differences.len();
        if n == 0 {
            return;
        }
        differences.sort_unstable_by(f64::total_cmp);
        let middle = &differences[n / 4..n - n / 4];
        self.location[pixel] = middle.iter().sum::<f64>() / middle.len() as f64;
        let at = |share: f64| differences[((n - 1) as f64 * share).round() as usize];
        self.scatter[pixel] = 0.5 * (at(0.84) - at(0.16));
        let mean = differences.iter().sum::<f64>() / n as f64;
        let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
        self.variance_ln[pixel] = (squares / (n.max(2) - 1) as f64).ln();
    }

    /// The values of pixels that are not absent.
    pub fn present<'a>(&'a self, values: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        values.iter().zip(&self.absent).filter(|(_, absent)| !**absent).map(|(value, _)| *value)
    }

    /// The indices of a pixel's neighbours of the same kind.
    pub fn around(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        self.within(pixel, 1)
    }

    /// The indices of all within this many steps along x and y.
    pub fn within(&self, pixel: usize, steps: i64) -> impl Iterator<Item = usize> + use<> {
        let [width, height] = self.size;
        near([pixel % width, pixel / width], [width, height], self.spacing, steps).map(move |[x, y]| y * width + x)
    }
}

/// The positions inside the picture within this many steps of one, without itself.
fn near(
    [x, y]: [usize; 2],
    [width, height]: [usize; 2],
    spacing: usize,
    steps: i64,
) -> impl Iterator<Item = [usize; 2]> {
    let all = (-steps..=steps).flat_map(move |dy| (-steps..=steps).map(move |dx| [dx, dy]));
    all.filter(|step| *step != [0, 0]).filter_map(move |step| {
        let [dx, dy] = step.map(|step| step * spacing as i64);
        let (x, y) = (x.checked_add_signed(dx as isize)?, y.checked_add_signed(dy as isize)?);
        (x < width && y < height).then_some([x, y])
    })
}

/// The median; the mean of the middle two for an even count; 0 if empty.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => 0.0,
        _ => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}
