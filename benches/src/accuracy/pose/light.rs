//! Light of coloured spots: profile, brightness, and mixing of channels; frames include spots partly out of the
//! picture.

use isophote_jit::PixelFormat;
use isophote_tracker::geometry::Rigid;
use isophote_tracker::{Frame, Plane, TargetSpot};

use super::scene::{BACKGROUND, HEIGHT, Random, Rim, SOFT, WIDTH, patch, place_inside};

/// The light of all spots.
#[derive(Clone, Debug)]
pub struct Light {
    pub rim: Rim,
    /// Brightness of each spot, DN.
    pub brightness: Vec<f64>,
    /// Response of each channel to each spot's light.
    pub mixing: Vec<Vec<f64>>,
}

impl Light {
    /// Spots with soft rims in one channel.
    pub fn grey(brightness: f64, spots: usize) -> Light {
        Light { rim: SOFT, brightness: vec![brightness; spots], mixing: vec![vec![1.0; spots]] }
    }

    /// Three spots in three channels with cross-talk between neighbours.
    pub fn mixed(rim: Rim, brightness: f64, cross_talk: f64) -> Light {
        let mixing = Light::matrix(cross_talk).map(Vec::from).to_vec();
        Light { rim, brightness: vec![brightness; 3], mixing }
    }

    /// Rows are channels, columns are lights.
    pub fn matrix(c: f64) -> [[f64; 3]; 3] {
        [[1.0, c, 0.25 * c], [c, 1.0, c], [0.2 * c, 0.7 * c, 1.0]]
    }

    /// Noise-free pixel values of each channel.
    pub fn means(&self, pose: &Rigid, spots: &[TargetSpot]) -> Vec<Vec<f64>> {
        let mut means = vec![vec![BACKGROUND; WIDTH * HEIGHT]; self.mixing.len()];
        for (index, spot) in spots.iter().enumerate() {
            let Some(place) = place_inside(pose, spot) else { continue };
            let patch = patch(pose, spot, self.rim, place, 8);
            for (channel, mixing) in means.iter_mut().zip(&self.mixing) {
                for (i, share) in patch.shares.iter().enumerate() {
                    let pixel = (patch.y + i / patch.width) * WIDTH + patch.x + i % patch.width;
                    channel[pixel] += mixing[index] * self.brightness[index] * share;
                }
            }
        }
        means
    }

    /// A frame with the camera's noise.
    pub fn frame(&self, pose: &Rigid, spots: &[TargetSpot], random: &mut Random) -> Frame {
        let read = |means: Vec<f64>| {
            let bytes = means.into_iter().map(|mean| random.read_out(mean)).collect();
            Plane::owned(PixelFormat::U8, bytes, WIDTH)
        };
        let planes = self.means(pose, spots).into_iter().map(read).collect();
        Frame::new(&[WIDTH, HEIGHT], planes).unwrap()
    }
}
