//! The programs of other libraries: made and run where those are installed, else left out by name.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Answer, Answers};

/// The programs that this machine can run, and why others are left out.
pub struct Programs {
    commands: Vec<Vec<PathBuf>>,
    /// One sentence each.
    pub skipped: Vec<String>,
}

/// Where courses and programs are kept.
pub fn folder() -> PathBuf {
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "..", "target", "peers"].iter().collect();
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn source(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "src", "peers", name].iter().collect()
}

impl Programs {
    /// Compiles what is to be compiled.
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
        let said = match compiler.output() {
            Ok(made) if made.status.success() => None,
            Ok(made) => Some(String::from_utf8_lossy(&made.stderr).into_owned()),
            Err(error) => Some(error.to_string()),
        };
        match said {
            None => commands.push(vec![ceres]),
            Some(said) => skipped.push(format!("Ceres: {}", said.lines().next().unwrap_or("no compiler"))),
        }
        Programs { commands, skipped }
    }

    /// One round of all programs over a course.
    pub fn answers(&mut self, course: &Path) -> Answers {
        let mut answers = Answers::new();
        for command in &self.commands {
            let output = match Command::new(&command[0]).args(&command[1..]).arg(course).output() {
                Ok(output) => output,
                Err(error) => {
                    self.skipped.push(format!("{}: {error}", command[0].display()));
                    continue;
                }
            };
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{command:?}: {said}");
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
