//! Resolves the options of `serve`: flag, else environment, else file (`--config`), else default; and records the
//! origin of each.
//!
//! A new option of `serve` gets its variable and its key automatically: `--vector-width` is `ISOPHOTE_VECTOR_WIDTH`
//! and `vector_width`.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::thread::Builder;
use std::time::Duration;

use clap::builder::BoolishValueParser;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command};
use serde::Serialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::failure::Failure;
use crate::output;
use crate::serve::ServeArgs;

/// Show each setting of `serve` and its origin
#[derive(Clone, Debug, clap::Args)]
pub struct ShowArgs {
    #[command(flatten)]
    serve: ServeArgs,
}

/// Options that choose an action: they have no variable and no key.
const ACTIONS: [&str; 4] = ["check", "json", "help", "version"];
/// Values of names with these endings are hidden: shown as set or unset.
const SECRETS: [&str; 3] = ["token", "secret", "password"];
/// Maximum size of the file.
const FILE_BYTES_MAX: u64 = 1 << 20;
/// Timeout for reading the whole file.
const READ_TIME: Duration = Duration::from_secs(5);

/// One option of `serve`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Setting {
    /// Key in the file.
    pub key: String,
    /// Value as given; absent if unset.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<String>,
    /// `flag`, `environment`, `file` or `default`.
    pub origin: &'static str,
    /// The variable, or the line of the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
}

/// A key of the file.
#[derive(Debug)]
struct FileValue {
    key: String,
    texts: Vec<String>,
    place: String,
}

/// Binds the environment variables to the options of `serve`.
pub fn with_variables(command: Command) -> Command {
    configured(command, &with_environment)
}

/// Parses the command line, [`with_variables`], and the file, and returns the settings of `serve` and `config show`.
///
/// # Errors
/// The file cannot be read or has an unknown option. Wrong usage exits the process, as always with clap.
pub fn matches(command: Command, arguments: Vec<OsString>) -> Result<(ArgMatches, Vec<Setting>), Failure> {
    let first = command.clone().get_matches_from(&arguments);
    let Some(chosen) = chosen(&first) else { return Ok((first, Vec::new())) };
    let options = options(&command);
    let file = match chosen.get_one::<PathBuf>("config") {
        Some(path) => read(path, &options)?,
        None => Vec::new(),
    };
    let with_file = |arg: Arg| match file.iter().find(|value| value.key == key_of(&arg)) {
        Some(value) => arg.default_values(value.texts.clone()),
        None => arg,
    };
    let second = configured(command, &with_file).get_matches_from(&arguments);
    let settings = self::chosen(&second).map(|chosen| settings(chosen, &options, &file)).unwrap_or_default();
    Ok((second, settings))
}

/// Prints the settings.
pub fn show(args: &ShowArgs, settings: &[Setting], out: &mut dyn Write) -> Result<(), Failure> {
    if args.serve.json {
        return output::json(out, &serde_json::json!({ "items": settings }));
    }
    let row = |setting: &Setting| {
        let value = setting.value.clone().unwrap_or_else(|| "-".into());
        let place = setting.place.as_ref().map(|place| format!(" {place}")).unwrap_or_default();
        vec![setting.key.clone(), value, format!("{}{place}", setting.origin)]
    };
    output::table(out, &["KEY", "VALUE", "FROM"], &settings.iter().map(row).collect::<Vec<_>>())
}

/// Changes the options of `serve`, and of `config show`, which has the same.
fn configured(command: Command, change: &impl Fn(Arg) -> Arg) -> Command {
    let change_all = |command: Command| command.mut_args(change);
    command
        .mut_subcommand("serve", change_all)
        .mut_subcommand("config", |config| config.mut_subcommand("show", change_all))
}

fn with_environment(arg: Arg) -> Arg {
    if ACTIONS.contains(&arg.get_id().as_str()) {
        return arg;
    }
    let name = format!("ISOPHOTE_{}", key_of(&arg).to_uppercase());
    // As with most programs, an empty variable counts as unset.
    if std::env::var_os(&name).is_some_and(|value| value.is_empty()) {
        return arg;
    }
    let is_switch = matches!(arg.get_action(), ArgAction::SetTrue);
    let arg = if is_switch { arg.value_parser(BoolishValueParser::new()) } else { arg };
    arg.env(name).hide_env_values(true)
}

/// Key of an option in the file.
fn key_of(arg: &Arg) -> String {
    arg.get_long().unwrap_or(arg.get_id().as_str()).replace('-', "_")
}

/// The matches of `serve` or `config show`.
fn chosen(matches: &ArgMatches) -> Option<&ArgMatches> {
    match matches.subcommand()? {
        ("serve", serve) => Some(serve),
        ("config", config) => config.subcommand_matches("show"),
        _ => None,
    }
}

/// The options that a file may set.
fn options(command: &Command) -> Vec<Arg> {
    let serve = command.find_subcommand("serve").into_iter().flat_map(Command::get_arguments);
    let is_option = |arg: &&Arg| !ACTIONS.contains(&arg.get_id().as_str()) && arg.get_id() != "config";
    serve.filter(is_option).cloned().collect()
}

fn read(path: &Path, options: &[Arg]) -> Result<Vec<FileValue>, Failure> {
    let text =
        text_in_time(path).map_err(|reason| Failure::Other(format!("{}: cannot be read: {reason}", path.display())))?;
    let at = |start: usize| {
        let head = &text[..text.floor_char_boundary(start)];
        let line = head.rfind('\n').map_or(head, |end| &head[end + 1..]);
        format!("{}:{}:{}", path.display(), 1 + head.matches('\n').count(), 1 + line.chars().count())
    };
    let table = DeTable::parse(&text).map_err(|error| {
        let place = at(error.span().map_or(0, |span| span.start));
        Failure::Other(format!("{place}: {}", error.message()))
    })?;
    table.get_ref().iter().map(|(key, value)| file_value(key, value, options, &at)).collect()
}

/// Reads the whole file, which may be a pipe from another program.
fn text_in_time(path: &Path) -> Result<String, String> {
    let (sender, text) = sync_channel(1);
    let from = path.to_path_buf();
    let read = move || {
        let mut text = String::new();
        let file = File::open(from).and_then(|file| file.take(FILE_BYTES_MAX + 1).read_to_string(&mut text));
        drop(sender.send(file.map(|_| text))); // the receiver timed out
    };
    let thread = Builder::new().name("configuration".into()).spawn(read);
    thread.map_err(|error| format!("there is no thread for it: {error}"))?;
    let late = |_| {
        let seconds = READ_TIME.as_secs();
        format!("it has no end after {seconds} s; who writes to a pipe has to close it")
    };
    let text = text.recv_timeout(READ_TIME).map_err(late)?.map_err(|error| error.to_string())?;
    if text.len() as u64 > FILE_BYTES_MAX {
        return Err(format!("it has more than {FILE_BYTES_MAX} bytes, which is hardly a configuration"));
    }
    Ok(text)
}

fn file_value(
    key: &Spanned<std::borrow::Cow<str>>,
    value: &Spanned<DeValue>,
    options: &[Arg],
    at: &dyn Fn(usize) -> String,
) -> Result<FileValue, Failure> {
    let (name, place) = (key.get_ref().to_string(), at(key.span().start));
    let Some(option) = options.iter().find(|option| key_of(option) == name) else {
        let known: Vec<String> = options.iter().map(key_of).collect();
        return Err(Failure::Other(format!("{place}: there is no key `{name}`; there are {}", known.join(", "))));
    };
    let is_switch = matches!(option.get_action(), ArgAction::SetTrue);
    let is_list = matches!(option.get_action(), ArgAction::Append);
    let wrong = |wanted: &str| Failure::Other(format!("{place}: `{name}` is {wanted}"));
    let texts = match (value.get_ref(), is_switch) {
        (DeValue::Boolean(on), true) => vec![on.to_string()],
        (_, true) => return Err(wrong("true or false")),
        (DeValue::Array(all), false) if is_list => {
            let texts = all.iter().map(|one| text_of(one.get_ref())).collect::<Option<_>>();
            texts.ok_or_else(|| wrong("a list of texts or numbers"))?
        }
        (one, false) => vec![text_of(one).ok_or_else(|| wrong("a text or a number"))?],
    };
    for text in texts.iter().filter(|_| !is_switch) {
        let line = ["serve".to_string(), format!("--{}={text}", option.get_long().unwrap_or(&name))];
        let tried = Command::new("serve").arg(option.clone().required(false)).try_get_matches_from(line);
        tried.map_err(|error| {
            let reason = error.to_string().lines().next().unwrap_or_default().trim_start_matches("error: ").to_string();
            Failure::Other(format!("{place}: {reason}"))
        })?;
    }
    Ok(FileValue { key: name, texts, place })
}

fn text_of(value: &DeValue) -> Option<String> {
    match value {
        DeValue::String(text) => Some(text.to_string()),
        DeValue::Integer(number) => Some(number.as_str().to_string()),
        DeValue::Float(number) => Some(number.as_str().to_string()),
        _ => None,
    }
}

fn settings(chosen: &ArgMatches, options: &[Arg], file: &[FileValue]) -> Vec<Setting> {
    let of = |option: &Arg| {
        let (key, id) = (key_of(option), option.get_id().as_str());
        let values = chosen.get_raw(id).map(|values| values.map(|value| value.to_string_lossy().into_owned()));
        let is_switch = matches!(option.get_action(), ArgAction::SetTrue);
        let value = match is_switch {
            true => Some(chosen.get_flag(id).to_string()),
            false => values.map(|values| values.collect::<Vec<_>>().join(",")),
        };
        let is_secret = !is_switch && SECRETS.iter().any(|ending| key.ends_with(ending));
        let in_file = file.iter().find(|value| value.key == key);
        let (origin, place) = match chosen.value_source(id) {
            Some(ValueSource::CommandLine) => ("flag", None),
            Some(ValueSource::EnvVariable) => {
                ("environment", option.get_env().map(|name| name.to_string_lossy().into_owned()))
            }
            _ => in_file.map_or(("default", None), |value| ("file", Some(value.place.clone()))),
        };
        let value = if is_secret { value.map(|_| "(set)".into()) } else { value };
        Setting { key, value, origin, place }
    };
    options.iter().map(of).collect()
}
