//! A minimal Markdown parser: fenced code blocks and the text outside them.

/// A fenced code block.
pub struct Block {
    /// The words after the fence, e.g. `toml model spot.toml`.
    pub words: Vec<String>,
    /// Line of the document on which the block's text begins, from 1.
    pub line: usize,
    /// The text between the fences.
    pub text: String,
}

/// The code blocks of a document, in order.
pub fn blocks(document: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for (number, line) in document.lines().enumerate() {
        match (line.trim_start().strip_prefix("```"), open.as_mut()) {
            (Some(info), None) => {
                let words = info.split_whitespace().map(String::from).collect();
                open = Some(Block { words, line: number + 2, text: String::new() });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (None, Some(block)) => block.text += &format!("{line}\n"),
            (None, None) => {}
        }
    }
    blocks
}

/// The document without code blocks and code spans; lines keep their numbers.
pub fn prose(document: &str) -> String {
    let mut inside = false;
    let mut prose = String::new();
    for line in document.lines() {
        let fence = line.trim_start().starts_with("```");
        if !inside && !fence {
            prose.extend(line.split('`').step_by(2));
        }
        inside ^= fence;
        prose.push('\n');
    }
    prose
}

/// The code spans outside code blocks.
pub fn spans(document: &str) -> Vec<String> {
    let mut inside = false;
    let mut spans = Vec::new();
    for line in document.lines() {
        let fence = line.trim_start().starts_with("```");
        if !inside && !fence {
            spans.extend(line.split('`').skip(1).step_by(2).map(String::from));
        }
        inside ^= fence;
    }
    spans
}

#[test]
fn blocks_and_prose_are_separated() {
    let document = "a `b` c\n```toml model x.toml\nk = 1\n```\nend\n";
    let found = blocks(document);
    assert_eq!((found.len(), found[0].line, found[0].text.as_str()), (1, 3, "k = 1\n"));
    assert_eq!(found[0].words, ["toml", "model", "x.toml"]);
    assert_eq!(prose(document), "a  c\n\n\n\nend\n");
    assert_eq!(spans(document), ["b"]);
}
