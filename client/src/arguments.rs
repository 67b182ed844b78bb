//! Values of options that several commands share: `k=v,…`, `k=FORMULA,…`, `x,y,w,h`, `640x480`, `64x64x32`.

use std::collections::BTreeMap;
use std::str::FromStr;

use isophote_capture::camera::ControlValue;
use isophote_jit::{Processor, Slices, VectorWidth, Window, fastest_width};
use isophote_machine::monotonic_ns;
use isophote_symbolic::Precision;

use crate::failure::Failure;

/// `k=v,…`: numbers by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NumberArgs(pub BTreeMap<String, f64>);

/// `k=FORMULA,…`: formulas by name; a comma inside brackets belongs to its formula.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FormulaArgs(pub BTreeMap<String, String>);

/// `k=v,…`: numbers, `true` and `false`, or words, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ValueArgs(pub BTreeMap<String, ControlValue>);

/// `x,y,w,h`: a pixel rectangle in all slices; `x,y,z,w,h,d`: in some slices; eight numbers: in some volumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowArgument(pub Window);

/// `MIN,MAX`: least and greatest size, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizesArgument(pub [f64; 2]);

/// `640x480`: one number per coordinate, the inner one first.
#[derive(Clone, Debug, PartialEq)]
pub struct Size(pub Vec<usize>);

/// Arithmetic of the pixel loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PrecisionArgument {
    /// 32-bit floats; rows are summed in f64.
    F32,
    /// 64-bit floats.
    F64,
}

impl From<PrecisionArgument> for Precision {
    fn from(argument: PrecisionArgument) -> Precision {
        match argument {
            PrecisionArgument::F32 => Precision::F32,
            PrecisionArgument::F64 => Precision::F64,
        }
    }
}

/// Vector width of the pixel loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum VectorWidthArgument {
    /// The fastest width on this machine, by measurement.
    Auto,
    /// 128 bits: the same sums on every machine, bit for bit.
    #[value(name = "128")]
    Bits128,
    /// 256 bits (x86-64 with AVX2 and FMA).
    #[value(name = "256")]
    Bits256,
    /// 512 bits (x86-64 with AVX-512).
    #[value(name = "512")]
    Bits512,
}

impl VectorWidthArgument {
    /// Resolves `auto` by measurement; fails if this processor lacks the width.
    pub fn width(self) -> Result<VectorWidth, Failure> {
        let width = match self {
            VectorWidthArgument::Auto => return Ok(fastest_width(&monotonic_ns)),
            VectorWidthArgument::Bits128 => VectorWidth::Bits128,
            VectorWidthArgument::Bits256 => VectorWidth::Bits256,
            VectorWidthArgument::Bits512 => VectorWidth::Bits512,
        };
        let bits = 8 * width.bytes();
        let absent = || Failure::Usage(format!("--vector-width {bits}: this processor has no vectors of {bits} bits"));
        Processor::Host.has(width).then_some(width).ok_or_else(absent)
    }
}

impl NumberArgs {
    /// Merges all options of one kind; a repeated name is an error.
    pub fn merged(options: &[NumberArgs]) -> Result<BTreeMap<String, f64>, String> {
        merged(options.iter().map(|option| &option.0))
    }
}

impl FormulaArgs {
    /// Merges all options of one kind; a repeated name is an error.
    pub fn merged(options: &[FormulaArgs]) -> Result<BTreeMap<String, String>, String> {
        merged(options.iter().map(|option| &option.0))
    }
}

impl ValueArgs {
    /// Merges all options of one kind; a repeated name is an error.
    pub fn merged(options: &[ValueArgs]) -> Result<BTreeMap<String, ControlValue>, String> {
        merged(options.iter().map(|option| &option.0))
    }
}

fn merged<'a, T: Clone + 'a>(
    maps: impl Iterator<Item = &'a BTreeMap<String, T>>,
) -> Result<BTreeMap<String, T>, String> {
    let mut all = BTreeMap::new();
    for (name, value) in maps.flatten() {
        if all.insert(name.clone(), value.clone()).is_some() {
            return Err(format!("`{name}` is given twice"));
        }
    }
    Ok(all)
}

impl FromStr for SizesArgument {
    type Err = String;
    fn from_str(text: &str) -> Result<SizesArgument, String> {
        let sizes = text
            .split_once(',')
            .and_then(|(least, most)| Some(SizesArgument([least.trim().parse().ok()?, most.trim().parse().ok()?])));
        sizes.ok_or_else(|| "two numbers: MIN,MAX".to_string())
    }
}

impl FromStr for NumberArgs {
    type Err = String;
    fn from_str(text: &str) -> Result<NumberArgs, String> {
        let mut numbers = BTreeMap::new();
        for (name, value) in pairs(text)? {
            let number: f64 = value.parse().map_err(|_| format!("`{value}` (of `{name}`) is not a number"))?;
            if !number.is_finite() {
                return Err(format!("`{name}` is {number}; it must be a finite number"));
            }
            if numbers.insert(name.to_string(), number).is_some() {
                return Err(format!("`{name}` is given twice"));
            }
        }
        Ok(NumberArgs(numbers))
    }
}

impl FromStr for FormulaArgs {
    type Err = String;
    fn from_str(text: &str) -> Result<FormulaArgs, String> {
        let mut formulas = BTreeMap::new();
        for (name, formula) in pairs(text)? {
            if formulas.insert(name.to_string(), formula.to_string()).is_some() {
                return Err(format!("`{name}` is given twice"));
            }
        }
        Ok(FormulaArgs(formulas))
    }
}

impl FromStr for ValueArgs {
    type Err = String;
    fn from_str(text: &str) -> Result<ValueArgs, String> {
        let mut values = BTreeMap::new();
        for (name, value) in pairs(text)? {
            let value = match (value.parse(), value.parse()) {
                (Ok(number), _) => ControlValue::Number(number),
                (_, Ok(on)) => ControlValue::Switch(on),
                _ => ControlValue::Word(value.to_string()),
            };
            if values.insert(name.to_string(), value).is_some() {
                return Err(format!("`{name}` is given twice"));
            }
        }
        Ok(ValueArgs(values))
    }
}

impl FromStr for WindowArgument {
    type Err = String;
    fn from_str(text: &str) -> Result<WindowArgument, String> {
        let wrong = || format!("`{text}` is not x,y,w,h: four whole numbers of pixels (six in a stack: x,y,z,w,h,d)");
        let numbers: Vec<usize> =
            text.split(',').map(|n| n.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
        if !matches!(numbers.len(), 2 | 4 | 6 | 8) {
            return Err(wrong());
        }
        let (first, count) = numbers.split_at(numbers.len() / 2);
        if count.contains(&0) {
            return Err(format!("`{text}` has no pixels: width and height must be positive"));
        }
        // Unnamed axes are covered completely.
        let first: [usize; 4] = std::array::from_fn(|axis| first.get(axis).copied().unwrap_or(0));
        let count: [usize; 4] = std::array::from_fn(|axis| count.get(axis).copied().unwrap_or(usize::MAX));
        let slices = Slices { first: [first[2], first[3]], count: [count[2], count[3]] };
        Ok(WindowArgument(Window { x: first[0], y: first[1], width: count[0], height: count[1], slices }))
    }
}

impl FromStr for Size {
    type Err = String;
    fn from_str(text: &str) -> Result<Size, String> {
        let wrong = || format!("`{text}` is not WIDTHxHEIGHT, e.g. 640x480 (64x64x32 for a stack)");
        let sides: Vec<usize> =
            text.split('x').map(|side| side.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
        if sides.len() > 4 { Err(wrong()) } else { Ok(Size(sides)) }
    }
}

/// Splits `k=v,…` at commas outside of brackets, and each part at its first `=`. An empty text has no pairs.
fn pairs(text: &str) -> Result<Vec<(&str, &str)>, String> {
    let mut parts = Vec::new();
    let (mut start, mut depth) = (0, 0i64);
    for (i, character) in text.char_indices() {
        match character {
            '(' | '[' => depth += 1,
            ')' | ']' => depth -= 1,
            ',' if depth <= 0 => {
                parts.push(&text[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    if text.trim().is_empty() {
        return Ok(Vec::new());
    }
    parts.into_iter().map(pair).collect()
}

fn pair(part: &str) -> Result<(&str, &str), String> {
    let (name, value) = part.split_once('=').unwrap_or((part, ""));
    let (name, value) = (name.trim(), value.trim());
    if name.is_empty() || value.is_empty() {
        return Err(format!("`{}` is not name=value", part.trim()));
    }
    Ok((name, value))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn formulas_keep_their_commas() {
        let text = "bx=320 + max(1, 2)*t , by = if(t <= 1, [1, 2][0], atan2(1, t)),v1=3";
        let FormulaArgs(formulas) = text.parse().unwrap();
        let expected = [("bx", "320 + max(1, 2)*t"), ("by", "if(t <= 1, [1, 2][0], atan2(1, t))"), ("v1", "3")];
        assert_eq!(formulas.len(), 3);
        for (name, formula) in expected {
            assert_eq!(formulas[name], formula);
        }
    }

    #[test]
    fn numbers_and_rectangles_are_read() {
        let NumberArgs(numbers) = "a1=2.5e-3, bx = -7".parse().unwrap();
        assert_eq!(numbers, BTreeMap::from([("a1".into(), 2.5e-3), ("bx".into(), -7.0)]));
        assert_eq!("".parse(), Ok(NumberArgs::default()));
        let window = Window { x: 1, y: 2, width: 30, height: 40, slices: Slices::ALL };
        assert_eq!("1,2, 30,40".parse(), Ok(WindowArgument(window)));
        let slices = Slices { first: [3, 0], count: [5, usize::MAX] };
        assert_eq!("1,2,3,30,40,5".parse(), Ok(WindowArgument(Window { slices, ..window })));
        let WindowArgument(line) = "7,9".parse().unwrap();
        assert_eq!(line.clipped(400, 1), Some(Window { x: 7, width: 9, ..Window::whole(400, 1) }));
        assert_eq!("640x480".parse(), Ok(Size(vec![640, 480])));
        assert_eq!("64x64x32x8".parse(), Ok(Size(vec![64, 64, 32, 8])));
    }

    #[test]
    fn controls_are_numbers_switches_or_words() {
        let ValueArgs(values) = "gain=10,hflip=true , auto_exposure=Manual Mode".parse().unwrap();
        assert_eq!(values["gain"], ControlValue::Number(10));
        assert_eq!(values["hflip"], ControlValue::Switch(true));
        assert_eq!(values["auto_exposure"], ControlValue::Word("Manual Mode".into()));
        assert!("gain=1,gain=2".parse::<ValueArgs>().is_err());
    }

    #[test]
    fn errors_state_the_expected_form() {
        let numbers = |text: &str| text.parse::<NumberArgs>().unwrap_err();
        assert_eq!(numbers("bx"), "`bx` is not name=value");
        assert_eq!(numbers("bx=1,,by=2"), "`` is not name=value");
        assert_eq!(numbers("bx=one"), "`one` (of `bx`) is not a number");
        assert_eq!(numbers("bx=inf"), "`bx` is inf; it must be a finite number");
        assert_eq!(numbers("bx=1,bx=2"), "`bx` is given twice");
        let twice = NumberArgs::merged(&["bx=1".parse().unwrap(), "bx=2".parse().unwrap()]);
        assert_eq!(twice.unwrap_err(), "`bx` is given twice");
        for text in ["1,2,3", "1,2,3,4,5", "1,2,-3,4", "a,b,c,d"] {
            assert!(text.parse::<WindowArgument>().unwrap_err().contains("four whole numbers of pixels"));
        }
        assert!("1,2,0,4".parse::<WindowArgument>().unwrap_err().contains("no pixels"));
        for text in ["640x", "axb", "1x2x3x4x5", ""] {
            assert!(text.parse::<Size>().unwrap_err().contains("e.g. 640x480"));
        }
    }
}
