//! A small JPEG writer for tests: every 8 × 8 block of each component has one value, so that the decoded picture is known
//! exactly for any subsampling.

/// One component: its sampling factors, width and height in blocks per MCU, and the value of each block.
pub struct Component {
    pub sampling: [usize; 2],
    /// By column and row of the block.
    pub value: fn(usize, usize) -> u8,
}

/// Bit writer, most significant bit first; 0xff is followed by 0 as the format requires.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    pending: u32,
    count: u32,
}

impl Bits {
    fn push(&mut self, value: u32, count: u32) {
        for bit in (0..count).rev() {
            self.pending = self.pending << 1 | (value >> bit & 1);
            self.count += 1;
            if self.count == 8 {
                self.bytes.push(self.pending as u8);
                if self.pending == 0xff {
                    self.bytes.push(0);
                }
                (self.pending, self.count) = (0, 0);
            }
        }
    }

    /// Pads with ones to a whole byte.
    fn fill(&mut self) {
        if self.count > 0 {
            self.push(0x7f, 8 - self.count);
        }
    }
}

fn segment(marker: u8, body: &[u8]) -> Vec<u8> {
    let length = (body.len() as u16 + 2).to_be_bytes();
    [&[0xff, marker][..], &length, body].concat()
}

/// A baseline JPEG of `size` px; the components have the numbers in `ids`. A restart marker follows every `interval` MCUs,
/// unless that is 0.
pub fn jpeg(size: [usize; 2], components: &[Component], ids: &[u8], interval: usize) -> Vec<u8> {
    let most = |axis: usize| components.iter().map(|one| one.sampling[axis]).max().unwrap();
    let units = [size[0].div_ceil(8 * most(0)), size[1].div_ceil(8 * most(1))];
    let mut bits = Bits::default();
    let mut before = vec![0i32; components.len()];
    for (n, (u, v)) in (0..units[1]).flat_map(|v| (0..units[0]).map(move |u| (u, v))).enumerate() {
        if interval > 0 && n > 0 && n % interval == 0 {
            bits.fill();
            bits.bytes.extend([0xff, 0xd0 + ((n / interval - 1) % 8) as u8]);
            before.fill(0);
        }
        for (component, before) in components.iter().zip(&mut before) {
            let [h, w] = [component.sampling[1], component.sampling[0]];
            for (i, j) in (0..h).flat_map(|j| (0..w).map(move |i| (i, j))) {
                // The DC coefficient is 8 times the mean; the quantizer divides by 8.
                let level = i32::from((component.value)(u * w + i, v * h + j)) - 128;
                let step = level - std::mem::replace(before, level);
                let category = 32 - step.unsigned_abs().leading_zeros();
                bits.push(category, 4); // the table below: category as 4 bits
                bits.push((if step < 0 { step - 1 } else { step }) as u32, category);
                bits.push(0, 1); // no further coefficients
            }
        }
    }
    bits.fill();
    let n = components.len() as u8;
    let mut start = vec![8];
    start.extend([size[1] as u16, size[0] as u16].map(u16::to_be_bytes).as_flattened());
    start.push(n);
    let mut scan = vec![n];
    for (component, id) in components.iter().zip(ids) {
        start.extend([*id, (component.sampling[0] << 4 | component.sampling[1]) as u8, 0]);
        scan.extend([*id, 0]);
    }
    scan.extend([0, 63, 0]);
    let quantiser = [&[0u8][..], &[8; 64]].concat();
    let first = [&[0u8, 0, 0, 0, 12][..], &[0; 12], &(0..12).collect::<Vec<u8>>()].concat();
    let others = [&[0x10u8, 1][..], &[0; 15], &[0]].concat();
    let head =
        [segment(0xdb, &quantiser), segment(0xc0, &start), segment(0xc4, &first), segment(0xc4, &others)].concat();
    let head = if interval > 0 { [segment(0xdd, &(interval as u16).to_be_bytes()), head].concat() } else { head };
    [&[0xff, 0xd8][..], &head, &segment(0xda, &scan), &bits.bytes, &[0xff, 0xd9]].concat()
}
