//! `isophote completions`, `isophote man`: shell completions and man pages from the definitions of `--help`.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use serde_json::json;

use crate::failure::Failure;
use crate::output;

/// Print the completion script for a shell
#[derive(Clone, Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell to generate the script for
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Write man pages: isophote.1, and one per command
#[derive(Clone, Debug, clap::Args)]
pub struct ManArgs {
    /// Folder to write to, such as a `man1` of the manpath
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// `isophote completions`.
pub fn completions(args: &CompletionsArgs, mut program: Command, out: &mut dyn Write) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "isophote", &mut script);
    out.write_all(&script).map_err(Failure::output)
}

/// `isophote man`.
pub fn man(args: &ManArgs, program: Command, out: &mut dyn Write) -> Result<(), Failure> {
    std::fs::create_dir_all(&args.out)
        .map_err(|error| Failure::Other(format!("{}: cannot be made: {error}", args.out.display())))?;
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let mut files: Vec<String> = Vec::new();
    write_pages(&program, &args.out, &mut files)?;
    if args.json {
        return output::json(out, &json!({ "files": files }));
    }
    writeln!(out, "{} pages in {}", files.len(), args.out.display()).map_err(Failure::output)
}

/// The page of a command, and those of its subcommands.
fn write_pages(command: &Command, folder: &Path, files: &mut Vec<String>) -> Result<(), Failure> {
    let page = Man::new(command.clone());
    let path = folder.join(page.get_filename());
    let mut bytes = Vec::new();
    page.render(&mut bytes).map_err(Failure::other)?;
    output::file(&path, &bytes)?;
    files.push(path.display().to_string());
    command.get_subcommands().try_for_each(|one| write_pages(one, folder, files))
}
