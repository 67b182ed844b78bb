//! Builds and runs the programs of other libraries; those not installed are skipped by name.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Answer, Answers};

/// The programs that run on this machine, and the reasons why others do not.
pub struct Programs {
    commands: Vec<Vec<PathBuf>>,
    /// One sentence each.
    pub skipped: Vec<String>,
}

/// Folder of courses and programs.
pub fn folder() -> PathBuf {
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "..", "target", "peers"].iter().collect();
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn source(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "src", "peers", name].iter().collect()
}

impl Programs {
    /// Compiles the programs.
    pub fn new() -> Programs {
        let (mut commands, mut skipped) = (vec![vec!["python3".into(), source("peers.py")]], Vec::new());
        let ceres = folder().join("ceres");
        let flags = [
            "-O3",
            "-march=native",
            "-ffast-math",
            "-fno-finite-math-only",
            "-DNDEBUG",
            "-std=c++17",
            "-I/usr/include/eigen3",
        ];
        let mut compiler = Command::new("c++");
        compiler.args(flags).arg(source("peers.cc")).arg("-o").arg(&ceres).args(["-lceres", "-lglog"]);
        let message = match compiler.output() {
            Ok(made) if made.status.success() => None,
            Ok(made) => Some(String::from_utf8_lossy(&made.stderr).into_owned()),
            Err(error) => Some(error.to_string()),
        };
        match message {
            None => commands.push(vec![ceres]),
            Some(message) => skipped.push(format!("Ceres: {}", message.lines().next().unwrap_or("no compiler"))),
        }
        Programs { commands, skipped }
    }

    /// One round of all programs over a course.
    pub fn answers(&mut self, sequence: &Path) -> Answers {
        let mut answers = Answers::new();
        for command in &self.commands {
            let output = match Command::new(&command[0]).args(&command[1..]).arg(sequence).output() {
                Ok(output) => output,
                Err(error) => {
                    self.skipped.push(format!("{}: {error}", command[0].display()));
                    continue;
                }
            };
            let message = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{command:?}: {message}");
            for line in String::from_utf8_lossy(&output.stdout).lines() {
                match line.split('\t').collect::<Vec<_>>()[..] {
                    ["skipped", why] => self.skipped.push(why.to_string()),
                    [name, took_us, x, y] => {
                        let number = |text: &str| text.parse::<f64>().unwrap();
                        let answer = Answer { took_us: number(took_us), centre: [number(x), number(y)] };
                        match answers.iter_mut().find(|(known, _)| known == name) {
                            Some((_, all)) => all.push(answer),
                            None => answers.push((name.to_string(), vec![answer])),
                        }
                    }
                    _ => panic!("{command:?} printed {line}"),
                }
            }
        }
        self.skipped.sort();
        self.skipped.dedup();
        answers
    }
}

impl Default for Programs {
    fn default() -> Programs {
        Programs::new()
    }
}
