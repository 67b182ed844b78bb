//! Lists the CLIF and the machine code of a program, each line with the value that it belongs to.
//!
//! A [`Line`] names the program's value and its byte span in the document; the caller turns spans into text. The
//! *source location* that [`crate::clif`] gives each instruction is the value's number.

use cranelift_codegen::Context;
use cranelift_codegen::ir::SourceLoc;
use isophote_symbolic::{Program, Span, Value};

use crate::compile::{audited, native, translate};
use crate::error::CompileError;
use crate::host::Processor;
use crate::options::{KernelOptions, VectorWidth};

/// One line of text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Line {
    /// The instruction, a label, or bytes of a constant.
    pub text: String,
    /// The value that it helps to compute; `None` for code of the loop itself.
    pub value: Option<Value>,
    /// The formula of that value, as a byte span of the document.
    pub span: Option<Span>,
}

/// The CLIF and the machine code of a program as text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Explained {
    /// The compiler's input, CLIF.
    pub clif: Vec<Line>,
    /// Machine instructions, then the constants that they read, as data.
    pub machine: Vec<Line>,
}

/// The program as CLIF and as machine code.
///
/// # Errors
/// Those of [`crate::Kernel::compile`].
pub fn explain(program: &Program, options: &KernelOptions) -> Result<Explained, CompileError> {
    if options.width != VectorWidth::Bits128 {
        return wide(program, options);
    }
    let (function, allocator) = audited(program, options, Processor::Host)?;
    let clif = function.display().to_string();
    let mut context = Context::for_function(function);
    context.set_disasm(!cfg!(target_arch = "x86_64"));
    let compiled = translate(&mut context, Processor::Host, allocator)?;
    let mut sources = Vec::new();
    for place in compiled.buffer.get_srclocs_sorted().iter().filter(|place| !place.loc.is_default()) {
        sources.push(Source { start: place.start as usize, end: place.end as usize, value: value(place.loc) });
    }
    let machine = match &compiled.vcode {
        Some(text) => text.lines().map(|line| (line.to_string(), None)).collect(),
        None => machine::lines(compiled.code_buffer(), &sources),
    };
    let explained = |lines: Vec<(String, Option<Value>)>| lines.into_iter().map(|l| line(program, l)).collect();
    Ok(Explained { clif: explained(clif.lines().map(of_clif).collect()), machine: explained(machine) })
}

/// Explains code with vectors that Cranelift lacks.
fn wide(program: &Program, options: &KernelOptions) -> Result<Explained, CompileError> {
    let native = native(program, options, Processor::Host)?;
    let source = |(start, end, value): &(usize, usize, Value)| Source { start: *start, end: *end, value: *value };
    let sources: Vec<Source> = native.sources.iter().map(source).collect();
    let text = format!("; vectors of {} bits do not pass through this form", 8 * options.width.bytes());
    let machine = machine::lines(&native.bytes, &sources).into_iter().map(|l| line(program, l)).collect();
    Ok(Explained { clif: vec![Line { text, value: None, span: None }], machine })
}

fn line(program: &Program, (text, value): (String, Option<Value>)) -> Line {
    let value = value.filter(|value| value.index() < program.instructions().len());
    Line { text, value, span: value.and_then(|value| program.instruction(value).span) }
}

fn value(place: SourceLoc) -> Value {
    Value(place.bits())
}

/// A range of machine code and its value.
struct Source {
    start: usize,
    end: usize,
    value: Value,
}

/// The compiler writes the source location before the instruction: `@002a   v7 = fadd v5, v6`.
fn of_clif(line: &str) -> (String, Option<Value>) {
    let place = line.strip_prefix('@').and_then(|rest| rest.split_once(' '));
    match place.and_then(|(number, rest)| Some((u32::from_str_radix(number, 16).ok()?, rest))) {
        Some((number, rest)) => (format!("    {}", rest.trim_start()), Some(Value(number))),
        None if line.starts_with(' ') => (format!("    {}", line.trim_start()), None),
        None => (line.to_string(), None),
    }
}

#[cfg(target_arch = "x86_64")]
mod machine {
    use std::collections::BTreeSet;

    use super::{Source, Value};
    use iced_x86::{Decoder, DecoderOptions, Formatter, Instruction, IntelFormatter, Mnemonic};

    /// Instructions, then data. The end of the code is not recorded: it is the first constant that an earlier instruction
    /// reads, or the zero padding before that.
    pub(super) fn lines(bytes: &[u8], sources: &[Source]) -> Vec<(String, Option<Value>)> {
        let mut formatter = IntelFormatter::new();
        let style = formatter.options_mut();
        style.set_hex_prefix("0x");
        style.set_hex_suffix("");
        style.set_space_after_operand_separator(true);
        style.set_branch_leading_zeros(false);
        style.set_rip_relative_addresses(false);
        let mut decoder = Decoder::with_ip(64, bytes, 0, DecoderOptions::NONE);
        let mut instruction = Instruction::default();
        let mut constants: BTreeSet<usize> = BTreeSet::new();
        let mut lines = Vec::new();
        let mut at = 0;
        while at < bytes.len() && !constants.contains(&at) {
            decoder.decode_out(&mut instruction);
            let mut text = String::new();
            formatter.format(&instruction, &mut text);
            let source = sources.partition_point(|source| source.end <= at);
            let value = sources.get(source).filter(|source| source.start <= at).map(|source| source.value);
            lines.push((format!("{at:5x}  {text}"), value));
            if instruction.is_ip_rel_memory_operand() {
                constants.insert(instruction.ip_rel_memory_address() as usize);
            }
            at = instruction.next_ip() as usize;
            let is_left = matches!(instruction.mnemonic(), Mnemonic::Ret | Mnemonic::Jmp | Mnemonic::Ud2);
            let gap = constants.first().map_or(0, |first| first.saturating_sub(at));
            if is_left && gap > 0 && bytes[at..at + gap].iter().all(|byte| *byte == 0) {
                at += gap;
            }
        }
        lines.extend(bytes[at..].chunks(16).enumerate().map(|(i, chunk)| {
            let words: Vec<String> = chunk.chunks(4).map(word).collect();
            (format!("{:5x}  data {}", at + 16 * i, words.join(" ")), None)
        }));
        lines
    }

    /// Up to four bytes as one little-endian number.
    fn word(bytes: &[u8]) -> String {
        bytes.iter().rev().map(|byte| format!("{byte:02x}")).collect()
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn trailing_constants_are_data_and_sources_give_values() {
            // addps xmm0, [rip + 8]; ret; a gap of zeros; 4 × 1.0
            let mut bytes = vec![0x0f, 0x58, 0x05, 9, 0, 0, 0, 0xc3];
            bytes.resize(16, 0);
            bytes.extend([0, 0, 0x80, 0x3f].repeat(4));
            let lines = lines(&bytes, &[Source { start: 0, end: 7, value: Value(5) }]);
            let expected = [
                ("    0  addps xmm0, [0x10]", Some(Value(5))),
                ("    7  ret", None),
                ("   10  data 3f800000 3f800000 3f800000 3f800000", None),
            ];
            assert_eq!(lines, expected.map(|(text, value)| (text.to_string(), value)));
        }
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod machine {
    use super::{Source, Value};

    /// There is no disassembler for this processor, and the compiler wrote no text.
    pub(super) fn lines(bytes: &[u8], _: &[Source]) -> Vec<(String, Option<Value>)> {
        vec![(format!("; {} bytes; the code of this processor cannot be shown", bytes.len()), None)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clif_lines_carry_their_value() {
        assert_eq!(of_clif("@002a   v7 = fadd v5, v6"), ("    v7 = fadd v5, v6".into(), Some(Value(42))));
        assert_eq!(of_clif("        jump block1"), ("    jump block1".into(), None));
        assert_eq!(of_clif("block1(v3: i64):"), ("block1(v3: i64):".into(), None));
    }
}
