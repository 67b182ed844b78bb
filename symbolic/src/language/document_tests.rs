//! Source maps of string literals: spells random texts at random in each kind of TOML and JSON string and checks the
//! span of each character. `SPELLINGS=100000` sets the number of cases.

#![allow(clippy::unwrap_used)]

use crate::graph::random::Random;
use crate::language::document::{Entry, Item, Text, read_json, read_toml};
use isophote_syntax::diagnostic::{Diagnostic, Span};
use isophote_syntax::spelling::Spelling;

#[derive(Clone, Copy, PartialEq, Debug)]
enum Kind {
    Basic,
    Literal,
    BasicLines,
    LiteralLines,
    Json,
}

const KINDS: [Kind; 5] = [Kind::Basic, Kind::Literal, Kind::BasicLines, Kind::LiteralLines, Kind::Json];

/// Characters of one to four bytes, blanks that TOML does not trim, quotes, and characters that need escapes.
const CHARACTERS: [char; 36] = [
    'a',
    'b',
    'x',
    '0',
    'u',
    'U',
    'n',
    '"',
    '\'',
    '\\',
    '/',
    '#',
    ' ',
    '\t',
    '\n',
    '\r',
    '\u{8}',
    '\u{c}',
    '\u{1b}',
    '\u{0}',
    '\u{7f}',
    '\u{85}',
    '\u{a0}',
    'é',
    'ß',
    '\u{301}',
    'Ω',
    '\u{2003}',
    '\u{2028}',
    '\u{feff}',
    '明',
    '\u{d7ff}',
    '\u{e000}',
    '\u{10000}',
    '😀',
    '\u{10ffff}',
];

fn below(random: &mut Random, count: usize) -> usize {
    (random.bits() % count as u64) as usize
}

/// A literal under construction, and the bytes of each character.
struct Pen<'r> {
    random: &'r mut Random,
    raw: String,
    places: Vec<(usize, usize)>,
}

impl Pen<'_> {
    fn chance(&mut self, one_in: usize) -> bool {
        below(self.random, one_in) == 0
    }

    fn add_one_of(&mut self, list: &[&str]) {
        self.raw += list[below(self.random, list.len())];
    }

    fn write(&mut self, spelled: &str) {
        let start = self.raw.len();
        self.raw += spelled;
        self.places.push((start, self.raw.len()));
    }

    /// Writes a line continuation with blanks around.
    fn continue_line(&mut self) {
        self.raw.push('\\');
        self.add_one_of(&["", " ", "\t "]);
        self.add_one_of(&["\n", "\r\n"]);
        for _ in 0..below(self.random, 4) {
            self.add_one_of(&["\n", "\r\n", " ", "\t", "  "]);
        }
    }

    /// Writes one of the escapes of a character.
    fn escape(&mut self, c: char, is_json: bool) {
        let code = u32::from(c);
        let short = match c {
            '\u{8}' => "\\b",
            '\t' => "\\t",
            '\n' => "\\n",
            '\u{c}' => "\\f",
            '\r' => "\\r",
            '"' => "\\\"",
            '\\' => "\\\\",
            '/' if is_json => "\\/",
            '\u{1b}' if !is_json => "\\e",
            _ => "",
        };
        let mut ways = Vec::from_iter((!short.is_empty()).then(|| short.to_string()));
        if !is_json {
            ways.extend((code < 0x100).then(|| format!("\\x{code:02X}")));
            ways.push(format!("\\U{code:08x}"));
        }
        ways.push(match code {
            0x10000.. if is_json => c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04X}")).collect(),
            0x10000.. => format!("\\U{code:08X}"),
            _ => format!("\\u{code:04x}"),
        });
        let way = below(self.random, ways.len());
        self.write(&ways[way]);
    }
}

/// A random text of this kind: its value, its literal, and the literal's bytes of each character.
fn spelled(random: &mut Random, kind: Kind) -> (String, String, Vec<(usize, usize)>) {
    let is_literal = matches!(kind, Kind::Literal | Kind::LiteralLines);
    let quotes = match kind {
        Kind::Basic | Kind::Json => "\"",
        Kind::Literal => "'",
        Kind::BasicLines => "\"\"\"",
        Kind::LiteralLines => "'''",
    };
    let quote = char::from(quotes.as_bytes()[0]);
    let is_of_lines = quotes.len() == 3;
    let mut text: Vec<char> = (0..below(random, 12)).map(|_| CHARACTERS[below(random, CHARACTERS.len())]).collect();
    let is_control = |c: char| c.is_ascii_control();
    if is_literal {
        text.retain(|c| !is_control(*c) || *c == '\t' || is_of_lines && *c == '\n');
        let mut in_a_row = 0;
        text.retain(|c| {
            in_a_row = if *c == quote { in_a_row + 1 } else { 0 };
            in_a_row == 0 || is_of_lines && in_a_row < 3
        });
    }
    let mut pen = Pen { random, raw: quotes.into(), places: Vec::new() };
    let first = text.first().copied();
    if is_of_lines && (first == Some('\n') || first == Some('\r') || pen.chance(2)) {
        // A newline after the opening quotes is not part of the value.
        pen.add_one_of(&["\n", "\r\n"]);
    }
    let mut in_a_row = 0;
    let mut value = String::new();
    for c in text {
        // A blank after a line continuation needs an escape.
        let mut is_trimmed = false;
        while kind == Kind::BasicLines && pen.chance(4) {
            pen.continue_line();
            is_trimmed = matches!(c, ' ' | '\t' | '\n');
        }
        let is_plain = match c {
            '\\' => is_literal,
            '"' => is_literal || (kind == Kind::BasicLines && in_a_row < 2),
            '\n' => is_of_lines && !is_trimmed,
            '\t' => kind != Kind::Json && !is_trimmed,
            ' ' => !is_trimmed,
            c => !is_control(c) || kind == Kind::Json && c == '\u{7f}',
        };
        value.push(c);
        if is_plain && (is_literal || pen.chance(2)) {
            in_a_row = if c == quote { in_a_row + 1 } else { 0 };
            pen.write(c.encode_utf8(&mut [0; 4]));
        } else {
            in_a_row = 0;
            pen.escape(c, kind == Kind::Json);
        }
    }
    if kind == Kind::BasicLines && pen.chance(4) {
        pen.continue_line();
    }
    pen.raw += quotes;
    let Pen { raw, places, .. } = pen;
    (value, raw, places)
}

/// A document around a literal, and the literal's offset.
fn document(random: &mut Random, kind: Kind, raw: &str) -> (String, usize) {
    let lines = below(random, 3);
    let (before, after) = match kind {
        Kind::Json => ("{".to_string() + &"\n ".repeat(lines) + "\"ké\": ", " }"),
        _ => ("# é\n".repeat(lines) + "\"ké\" = ", " # é\n"),
    };
    (before.clone() + raw + after, before.len())
}

fn only_text(root: &Entry) -> Text {
    let Item::Table(table) = &root.item else { panic!("no table") };
    let Item::Text(text) = &table[0].1.item else { panic!("no text") };
    text.clone()
}

#[test]
fn every_character_maps_to_its_source_bytes() {
    let count: u64 = std::env::var("SPELLINGS").ok().and_then(|n| n.parse().ok()).unwrap_or(20_000);
    for seed in 0..count {
        let mut random = Random(seed);
        let kind = KINDS[below(&mut random, KINDS.len())];
        let (value, raw, places) = spelled(&mut random, kind);
        let (document, start) = document(&mut random, kind, &raw);
        let read = if kind == Kind::Json { read_json(&document) } else { read_toml(&document) };
        let (root, told) = read.unwrap_or_else(|faults| panic!("seed {seed}, {kind:?}: {document:?}: {faults:?}"));
        assert!(told.is_empty(), "seed {seed}: {told:?}");
        let text = only_text(&root);
        assert_eq!(*text.value, *value, "seed {seed}, {kind:?}: {document:?}");
        assert!(!matches!(text.spelling, Spelling::Somewhere(_)), "seed {seed}, {kind:?}: {document:?} not understood");
        let mut end = None;
        for ((at, c), (a, b)) in value.char_indices().zip(&places) {
            let expected = Span { start: (start + a) as u32, end: (start + b) as u32 };
            assert_eq!(text.span(at, at + c.len_utf8()), expected, "seed {seed}, {kind:?}: {c:?} of {document:?}");
            let shown = Diagnostic::error(&document, "code", "key", expected, "message");
            let line_start = document[..start + a].rfind('\n').map_or(0, |at| at + 1);
            let column = document[line_start..start + a].chars().count() + 1;
            let line = document[..start + a].split('\n').count();
            assert_eq!(
                (shown.line as usize, shown.column as usize, shown.span),
                (line, column, expected),
                "seed {seed}"
            );
            let is_marked = shown.render("document").contains('^');
            assert!(is_marked != shown.source.is_empty(), "seed {seed}: a fault is marked unless its line is empty");
            end = Some(expected.end);
        }
        // From the first character to the last, and the end itself.
        if let (Some(end), Some((a, _))) = (end, places.first()) {
            let whole = Span { start: (start + a) as u32, end };
            assert_eq!(text.span(0, value.len()), whole, "seed {seed}: {document:?}");
            assert_eq!(text.span(value.len(), value.len() + 9), Span { start: end, end }, "seed {seed}");
        }
    }
}

/// The first seeds must reach every kind of spelling.
#[test]
fn generator_reaches_every_spelling() {
    let mut seen = String::new();
    for seed in 0..20_000 {
        let mut random = Random(seed);
        let kind = KINDS[below(&mut random, KINDS.len())];
        seen += &spelled(&mut random, kind).1;
        seen.push('\u{fffe}');
    }
    let ways = [
        "\\b",
        "\\t",
        "\\n",
        "\\f",
        "\\r",
        "\\\"",
        "\\\\",
        "\\/",
        "\\e",
        "\\xA0",
        "\\u00e9",
        "\\U0001f600",
        "\\uD83D\\uDE00",
        "\"\"\"\n",
        "\"\"\"\r\n",
        "'''\n",
        "\"\"\"\"\u{fffe}",
        "\"\"\"\"\"\u{fffe}",
        "''''\u{fffe}",
        "'''''\u{fffe}",
        "\\\n\\\n",
        "\\\r\n\\",
        "\\\n\u{a0}",
        "\\ \n",
        "\\\t \r\n",
        "\\\n\u{2003}",
        "\\\n\"\"\"\u{fffe}",
    ];
    let missing: Vec<&str> = ways.into_iter().filter(|way| !seen.contains(way)).collect();
    assert!(missing.is_empty(), "never spelled: {missing:?}");
}

/// Regression: the smallest documents that were read past a character boundary.
#[test]
fn line_continuations_and_no_break_space_map_correctly() {
    for (raw, value, first) in [("\"\"\"\\\n\\\néa\"\"\"", "éa", 7), ("\"\"\"\\\n\u{a0}té\"\"\"", "\u{a0}té", 5)] {
        let (root, _) = read_toml(&format!("a = {raw}")).unwrap();
        let text = only_text(&root);
        assert_eq!(&*text.value, value);
        assert_eq!(text.span(0, 2), Span { start: 4 + first, end: 4 + first + 2 }, "{raw}");
    }
}

/// A value that disagrees with its literal maps to the whole literal.
#[test]
fn disagreeing_value_maps_to_the_whole_literal() {
    for (value, raw) in
        [("ab", "\"\\x61c\""), ("ab", "\"\\x61\""), ("a", "\"\\x61b\""), ("é", "\"\\q\""), ("a", "\"\\u00")]
    {
        let spelling = Spelling::of(value, raw, 10);
        let whole = Span { start: 10, end: 10 + raw.len() as u32 };
        assert_eq!(spelling.span(0, 1, value.len()), whole, "{value:?} in {raw:?}");
    }
    // Bytes within a character have its span.
    assert_eq!(Spelling::of("é", "\"\\u00e9\"", 0).span(1, 2, 2), Span { start: 1, end: 7 });
}
