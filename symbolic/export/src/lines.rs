//! Builds the lines of a file.

/// Lines with their indentation.
#[derive(Default)]
pub(super) struct File {
    pub text: String,
    depth: usize,
}

impl File {
    pub fn line(&mut self, line: &str) {
        if !line.is_empty() {
            self.text += &"    ".repeat(self.depth);
            self.text += line;
        }
        self.text.push('\n');
    }
    pub fn lines(&mut self, lines: &[String]) {
        lines.iter().for_each(|line| self.line(line));
    }
    pub fn open(&mut self, line: &str) {
        self.line(line);
        self.depth += 1;
    }
    pub fn turn(&mut self, line: &str) {
        self.depth -= 1;
        self.open(line);
    }
    pub fn close(&mut self, line: &str) {
        self.depth -= 1;
        self.line(line);
    }
}
