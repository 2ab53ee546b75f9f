//! `rins monitor`

use super::arguments::value::number_in;
use super::ending::Ending;
use super::interrupt::Interrupt;
use super::output::{is_quiet, must_sayln};
use super::{files, history};
use crate::files::json_file::write_json;
use crate::files::toml_file::TomlFile;
use crate::monitor::history::History;
use crate::monitor::{Client, Event, LineClosed, Recording, UNEXPECTED, View, lines, open, refused};
use crate::result::report::StoredReport;
use crate::result::table::explained;
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use console::{Key, Term};
use nix::sys::termios::{SetArg, Termios, tcgetattr, tcsetattr};
use rins_selfcal::keep::black_box::Entry;
use rins_selfcal::link::{Answer, Command, Item, Refusal, Setting, SettingName};
use rins_selfcal::run::assignment::Assignment;
use rins_selfcal::run::config::SelfCalibrationConfig;
use rins_selfcal::run::result::StoredCalibration;
use serde::Serialize;
use std::fs::File;
use std::io::IsTerminal;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Time between two updates of the screen.
const PICTURE: Duration = Duration::from_millis(200);
/// First line of the screen: the keys.
const KEYS: &str = "keys     s start, a abort, u unlock, e erase, q quit";

#[derive(Debug, Args)]
pub struct MonitorArguments {
    /// Serial device, pseudo-terminal, Unix socket or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Speed of a serial device, baud
    #[arg(long, value_name = "BAUD", default_value_t = 921_600)]
    baud: u32,
    /// Longest time to wait for an answer, s; an instrument may be busy for 4 s while it erases a flash sector
    #[arg(long, value_name = "S", default_value_t = 5)]
    wait: u64,
    /// Start a run, and follow the run to its end
    #[arg(long, conflicts_with_all = ["abort", "read", "configure", "erase"])]
    start: bool,
    /// Abort the run
    #[arg(long)]
    abort: bool,
    /// Read data from the instrument, and print them
    #[arg(long, value_enum)]
    read: Option<ReadArgument>,
    /// Write the data of --read to this file
    #[arg(long, value_name = "OUT.json", requires = "read")]
    json: Option<PathBuf>,
    /// Set the configuration until power-off, from a file in the form that `--read configuration` prints
    #[arg(long, value_name = "CONFIG.toml", requires = "unlock")]
    configure: Option<PathBuf>,
    /// Erase the stored calibrations
    #[arg(long, requires = "unlock")]
    erase: bool,
    /// Record every corrected sample until q, Ctrl-C, SIGTERM, or the line closes
    #[arg(long, value_name = "OUT.csv", conflicts_with_all = ["start", "abort", "read", "configure", "erase"])]
    record: Option<PathBuf>,
    /// Stop recording after this time, s
    #[arg(long, value_name = "S", requires = "record", value_parser = seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,
    /// Unlock the instrument for `--configure` and `--erase`
    #[arg(long)]
    unlock: bool,
}

/// Data that can be read.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum ReadArgument {
    /// The stored calibration
    Calibration,
    /// All stored calibrations, including rejected ones
    History,
    /// The black box: the last events, and why the software started
    BlackBox,
    /// The live configuration
    Configuration,
    /// State, time left, angles, lost samples and messages
    Status,
}

pub fn run(arguments: &MonitorArguments) -> Result<Ending> {
    let json = arguments.json.as_deref();
    files::check(
        &[("--configure", arguments.configure.as_deref())],
        &[("--json", json), ("--record", arguments.record.as_deref())],
    )?;
    let config = arguments.configure.as_deref().map(configured).transpose()?;
    let mut client = Client::new(open(&arguments.port, arguments.baud)?, Duration::from_secs(arguments.wait));
    if let Some(item) = arguments.read {
        read(&mut client, item, json)?;
    }
    if let Some(config) = &config {
        configure(&mut client, config)?;
    }
    if arguments.erase {
        client.ask_unlocked(&Command::Erase, |_| ())?;
        tell("the stored calibrations are erased");
    }
    if arguments.abort {
        client.ask(&Command::Abort, |_| ())?;
        tell("the run is aborted");
    }
    let once = arguments.abort || arguments.erase || arguments.read.is_some() || config.is_some();
    if once { Ok(Ending::Done) } else { follow(&mut client, arguments) }
}

/// Reads a configuration file, and refuses unknown keys.
fn configured(path: &Path) -> Result<SelfCalibrationConfig> {
    let file = TomlFile::read(path)?;
    let config: SelfCalibrationConfig = file.parse()?;
    let known = toml::Value::try_from(&config)?;
    match unknown_key(&file.parse()?, &known) {
        Some((table, key)) => Err(file.wrong_value(&table, &key, "unknown key").into()),
        None => Ok(config),
    }
}

/// The first unknown key, with its table.
fn unknown_key(found: &toml::Value, known: &toml::Value) -> Option<(String, String)> {
    let tables = found.as_table().zip(known.as_table())?;
    tables.0.iter().find_map(|(key, value)| match tables.1.get(key) {
        None => Some((String::new(), key.clone())),
        Some(known) => unknown_key(value, known).map(|(table, inner)| {
            let inside = if table.is_empty() { key.clone() } else { format!("{key}.{table}") };
            (inside, inner)
        }),
    })
}

/// Length of a recording, s: up to a year.
fn seconds(text: &str) -> Result<f64, String> {
    number_in(text, 0.001, 3.2e7)
}

fn tell(text: &str) {
    if !is_quiet() {
        must_sayln!("{text}");
    }
}

// ------------------------------------------------------------------------------------------------------------ commands

fn read(client: &mut Client, item: ReadArgument, json: Option<&Path>) -> Result<()> {
    match item {
        ReadArgument::Calibration => {
            let stored = stored(client)?;
            let report = StoredReport::from(&stored);
            match json {
                Some(path) => write_json(path, &report),
                None => print_toml(&report),
            }
        }
        ReadArgument::History => {
            let entries = series(
                client,
                |back| Item::History { back },
                |answer| match answer {
                    Answer::Calibration(entry) => Some(entry),
                    _ => None,
                },
            )?;
            history::show(&History { entries, ..History::default() }, json)
        }
        ReadArgument::BlackBox => {
            let events = series(
                client,
                |back| Item::Event { back },
                |answer| match answer {
                    Answer::Event(event) => Some(event),
                    _ => None,
                },
            )?;
            match json {
                Some(path) => write_json(path, &events.iter().map(EventReport::from).collect::<Vec<_>>()),
                None => {
                    events.iter().rev().for_each(|event| must_sayln!("{}", event_line(event)));
                    Ok(())
                }
            }
        }
        ReadArgument::Configuration => {
            let config = configuration(client)?;
            match json {
                Some(path) => write_json(path, &config),
                None => print_toml(&config),
            }
        }
        ReadArgument::Status => {
            let Answer::Status(status) = client.ask(&Command::Status, |_| ())? else { bail!(UNEXPECTED) };
            match json {
                Some(path) => write_json(path, &status),
                None => print_toml(&status),
            }
        }
    }
}

/// Reads all entries of one kind, newest first, until the instrument has no more.
fn series<T>(client: &mut Client, item: impl Fn(u16) -> Item, of: impl Fn(Answer) -> Option<T>) -> Result<Vec<T>> {
    let mut all = Vec::new();
    for back in 0.. {
        match client.answer(&Command::Read(item(back)), |_| ())? {
            Answer::Refused(Refusal::Nothing) => break,
            Answer::Refused(refusal) => return Err(refused(&refusal)),
            answer => all.push(of(answer).context(UNEXPECTED)?),
        }
    }
    Ok(all)
}

/// An event in the JSON file.
#[derive(Serialize)]
struct EventReport {
    sequence: u32,
    time_s: f64,
    event: String,
    repeats: u8,
}

impl From<&Entry> for EventReport {
    fn from(entry: &Entry) -> Self {
        let (time_s, event) = (entry.time_us as f64 * 1e-6, entry.event.to_string());
        Self { sequence: entry.sequence, time_s, event, repeats: entry.repeats }
    }
}

fn event_line(entry: &Entry) -> String {
    let EventReport { sequence, time_s, event, repeats } = entry.into();
    let more = if repeats == u8::MAX { " or more" } else { "" };
    let repeats = if repeats > 0 {
        format!("; consecutive starts with this event: {}{more}", u16::from(repeats) + 1)
    } else {
        String::new()
    };
    format!("{sequence:>6}  {time_s:>12.3} s  {event}{repeats}")
}

fn stored(client: &mut Client) -> Result<StoredCalibration> {
    match client.ask(&Command::Read(Item::Calibration), |_| ()).context("the stored calibration")? {
        Answer::Calibration(stored) => Ok(stored),
        _ => bail!(UNEXPECTED),
    }
}

fn configuration(client: &mut Client) -> Result<SelfCalibrationConfig> {
    let Assignment::SelfCalibrate(mut config) = Assignment::default() else { bail!("no default configuration") };
    for name in SettingName::ALL {
        match client.ask(&Command::Read(Item::Setting(name)), |_| ())? {
            Answer::Setting(setting) => setting.put(&mut config),
            _ => bail!(UNEXPECTED),
        }
    }
    Ok(config)
}

/// Sends the settings that differ. The instrument checks each setting together with all its other settings.
fn configure(client: &mut Client, config: &SelfCalibrationConfig) -> Result<()> {
    let present = configuration(client)?;
    for name in SettingName::ALL {
        let setting = Setting::of(config, name);
        if setting != Setting::of(&present, name) {
            client.ask_unlocked(&Command::Set(setting), |_| ()).with_context(|| format!("{name:?}"))?;
        }
    }
    Ok(())
}

fn print_toml(value: &impl Serialize) -> Result<()> {
    must_sayln!("{}", toml::to_string(value)?.trim_end());
    Ok(())
}

// ---------------------------------------------------------------------------------------------------------------- live

/// Shows events until the user quits, until the run that this program started has ended, or until the recording is
/// complete.
fn follow(client: &mut Client, arguments: &MonitorArguments) -> Result<Ending> {
    let mut show = Show::new();
    let interrupt = if arguments.record.is_some() || show.screen.is_some() {
        Interrupt::handled().context("signals")?
    } else {
        Interrupt::default()
    };
    let answer = client.ask(&Command::Hello, |event| show.event(event))?;
    show.event(&Event::Answer(0, answer));
    if let Some(path) = &arguments.record {
        show.recording = Some(Recording::begin(client, path, |event| show.event(event))?);
    }
    if arguments.start {
        client.ask(&Command::Start, |event| show.event(event))?;
        show.started = true;
    }
    let ending = match watch(client, &mut show, arguments.seconds, &interrupt) {
        // Without a time, a recording lasts until the instrument is switched off.
        Err(error) if error.is::<LineClosed>() && show.recording.is_some() && arguments.seconds.is_none() => {
            tell(&error.to_string());
            Ok(Ending::Done)
        }
        ending => ending,
    };
    let recorded = end_recording(client, &mut show);
    ending.and_then(|ending| recorded.map(|()| ending))
}

fn watch(client: &mut Client, show: &mut Show, seconds: Option<f64>, interrupt: &Interrupt) -> Result<Ending> {
    let end = seconds.map(|seconds| Instant::now() + Duration::from_secs_f64(seconds));
    loop {
        client.poll()?.iter().for_each(|event| show.event(event));
        if let Some(command) = show.due()? {
            client.ask(&command, |event| show.event(event))?;
        }
        if let Some(accepted) = show.ended() {
            show.picture(client);
            return Ok(if accepted { Ending::Done } else { Ending::NotAccepted });
        }
        let over = end.is_some_and(|end| Instant::now() >= end);
        if over || interrupt.is_requested() || !show.handle_key(client)? {
            return Ok(Ending::Done);
        }
        show.picture_if_due(client);
    }
}

/// Switches the stream off, writes the rest of the recording, and prints what the recording holds.
fn end_recording(client: &mut Client, show: &mut Show) -> Result<()> {
    let Some(recording) = show.recording.take() else { return Ok(()) };
    let (summary, ended) = recording.end(client, |event| show.event(event));
    must_sayln!("{summary}");
    match ended {
        Err(error) if error.is::<LineClosed>() => Ok(()),
        ended => ended,
    }
}

/// Shows events on a live screen, or prints lines if the output is not a terminal.
struct Show {
    view: View,
    screen: Option<Screen>,
    quiet: bool,
    started: bool,
    /// What became of the last key, in lines.
    note: Vec<String>,
    /// Writes the corrected samples to a file.
    recording: Option<Recording>,
}

struct Screen {
    term: Term,
    keys: Receiver<Key>,
    lines: usize,
    drawn: Option<Instant>,
    _settings: Option<TerminalSettings>,
}

/// The settings of the terminal, restored at the end: the thread that waits for a key leaves the terminal in raw mode.
struct TerminalSettings(OwnedFd, Termios);

impl TerminalSettings {
    /// The settings now. The keys come from the standard input or, if this is no terminal, from `/dev/tty`.
    fn saved() -> Option<Self> {
        let input = std::io::stdin();
        let terminal = if input.is_terminal() {
            input.as_fd().try_clone_to_owned().ok()?
        } else {
            File::open("/dev/tty").ok()?.into()
        };
        let settings = tcgetattr(&terminal).ok()?;
        Some(Self(terminal, settings))
    }
}

impl Drop for TerminalSettings {
    fn drop(&mut self) {
        // An error is ignored: a terminal that has closed needs no settings.
        let _ = tcsetattr(&self.0, SetArg::TCSADRAIN, &self.1);
    }
}

impl Show {
    fn new() -> Self {
        let term = Term::stdout();
        let screen = (term.is_term() && !is_quiet()).then(|| Screen::new(term));
        let quiet = is_quiet();
        Self { view: View::default(), screen, quiet, started: false, note: Vec::new(), recording: None }
    }

    fn event(&mut self, event: &Event) {
        self.view.note(event);
        if let Some(recording) = &mut self.recording {
            recording.note(event);
        }
        if let Event::Answer(1.., Answer::Refused(refusal)) = event {
            self.note = vec![format!("refused  {refusal}"), explained(refusal.code())];
        }
        let verdict = self.quiet && matches!(event, Event::Message(message) if is_end(message));
        if self.screen.is_none() && (verdict || !self.quiet) {
            lines(event).iter().for_each(|line| must_sayln!("{line}"));
        }
    }

    /// Whether the run that this program started has ended with success; `None` before its end.
    fn ended(&self) -> Option<bool> {
        self.view.ended().filter(|_| self.started)
    }

    /// The command that the recording needs now.
    fn due(&mut self) -> Result<Option<Command>> {
        self.recording.as_mut().map_or(Ok(None), Recording::due)
    }

    /// Sends the command of the last key. Returns whether to go on.
    fn handle_key(&mut self, client: &mut Client) -> Result<bool> {
        let Some(screen) = &self.screen else { return Ok(true) };
        let Ok(key) = screen.keys.try_recv() else { return Ok(true) };
        let unlock = Command::Unlock(rins_selfcal::link::UNLOCK_WORD);
        let (note, command) = match key {
            Key::Char('s') => ("start", Command::Start),
            Key::Char('a') => ("abort", Command::Abort),
            Key::Char('u') => ("unlock", unlock),
            Key::Char('e') => ("erase", Command::Erase),
            key => return Ok(!is_quit(&key)),
        };
        self.note = vec![format!("command  {note}")];
        client.send(&command)?;
        Ok(true)
    }

    fn picture_if_due(&mut self, client: &Client) {
        if self.screen.as_ref().is_some_and(Screen::is_due) {
            self.picture(client);
        }
    }

    fn picture(&mut self, client: &Client) {
        let Some(screen) = &mut self.screen else { return };
        let width = screen.term.size().1.into();
        let view = self.view.screen(width, client.dropped(), client.missing());
        screen.draw(std::iter::once(KEYS.into()).chain(self.note.iter().cloned()).chain(view));
    }
}

fn is_end(message: &rins_selfcal::run::telemetry::Message) -> bool {
    use rins_selfcal::run::telemetry::Message;
    matches!(message, Message::Judged(_) | Message::Aborted(_) | Message::Saved(false))
}

fn is_quit(key: &Key) -> bool {
    matches!(key, Key::Char('q') | Key::CtrlC)
}

impl Screen {
    /// Reads the keys in a separate thread that ends with the program. Ctrl-C is a key, and not a signal that would end
    /// the program at once.
    fn new(term: Term) -> Self {
        let settings = TerminalSettings::saved();
        let (sender, keys) = channel();
        let keyboard = term.clone();
        thread::spawn(move || {
            while let Ok(key) = keyboard.read_key_raw() {
                let is_last = is_quit(&key);
                if sender.send(key).is_err() || is_last {
                    break;
                }
            }
        });
        Self { term, keys, lines: 0, drawn: None, _settings: settings }
    }

    fn is_due(&self) -> bool {
        self.drawn.is_none_or(|drawn| drawn.elapsed() >= PICTURE)
    }

    fn draw(&mut self, lines: impl Iterator<Item = String>) {
        let (rows, columns) = self.term.size();
        let fits = |line: String| line.chars().take(columns.into()).collect::<String>();
        let text: Vec<_> = lines.take(usize::from(rows).saturating_sub(1)).map(fits).collect();
        // Errors are ignored: if the terminal has closed, nobody looks at the screen.
        let _ = self.term.clear_last_lines(self.lines);
        let _ = self.term.write_line(&text.join("\n"));
        (self.lines, self.drawn) = (text.len(), Some(Instant::now()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_with_an_unknown_key_is_refused_in_optional_tables_too() {
        let Assignment::SelfCalibrate(config) = Assignment::default() else { panic!("the default") };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        let text = toml::to_string(&config).unwrap();
        let refusal = |text: String| {
            std::fs::write(&path, text).unwrap();
            configured(&path).map_or_else(|error| format!("{error:#}"), |_| "fine".into())
        };
        assert_eq!(refusal(text.clone()), "fine");
        assert_eq!(refusal(format!("utc_s = 1700000000\n{text}")), "fine");
        let message = refusal(format!("uct_s = 1700000000\n{text}"));
        assert!(message.ends_with("config.toml:1: uct_s: unknown key"), "{message}");
        let message = refusal(text.replace("[pace]\n", "[pace]\nlongest = 5.0\n"));
        assert!(message.ends_with(": longest: unknown key"), "{message}");
    }
}
