//! `monoslam-server config`: whether the configuration can be used, and where each of its values comes from.

use crate::config::{Config, ConfigArgs, sources};
use crate::connections::Certificates;
use crate::current::fields_of;
use crate::data::database_of;
use anyhow::{Context, ensure};
use clap::Subcommand;
use config::{Source, ValueKind};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::io::Write;
use std::net::TcpListener;
use std::path::PathBuf;

/// The environment's variable that goes before the field `log_filter`.
const LOG_VARIABLE: &str = "RUST_LOG";

/// Other names of fields that are taken as well.
const ALIASES: [(&str, &str); 1] = [("sessions.n_localizations", "sessions.n_localisations")];

/// Width of a field with its value, before where it comes from.
const COLUMN: usize = 50;

/// What to do with the configuration.
#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Checks the configuration, the certificate, the data folder and the addresses, and changes nothing;
    /// exits with 1 if a server would not start with them
    Check,
    /// Prints every value with where it comes from; the output can be used as a configuration file
    Show,
}

/// Where a value comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Origin {
    Default,
    File(PathBuf),
    /// The variable's name.
    Environment(String),
    Flag(&'static str),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File(file) => write!(f, "file {}", file.display()),
            Self::Environment(variable) => write!(f, "environment {variable}"),
            Self::Flag(flag) => write!(f, "flag {flag}"),
        }
    }
}

impl ConfigCommand {
    /// Does it with the configuration that the arguments lead to, and prints the outcome to `out`.
    ///
    /// # Errors
    /// If a server would not start with it.
    pub fn run(&self, config: &Config, args: &ConfigArgs, out: &mut impl Write) -> anyhow::Result<()> {
        match self {
            Self::Check => check(config, out),
            Self::Show => show(config, args, out),
        }
    }
}

/// Looks at what the configuration names.
fn check(config: &Config, out: &mut impl Write) -> anyhow::Result<()> {
    config.validate()?;
    let encrypted = if Certificates::of(&config.tls)?.is_some() { "encrypted" } else { "not encrypted" };
    check_folder(config)?;
    for (field, addr) in [("grpc_addr", config.grpc_addr), ("http_addr", config.http_addr)] {
        // Not the port: a server that runs has it.
        TcpListener::bind((addr.ip(), 0))
            .with_context(|| format!("{field}: cannot listen on {}", addr.ip()))?;
        let is_open = !addr.ip().to_canonical().is_loopback();
        if is_open && !config.access.insecure && config.storage.url.is_none() && !database_of(config).exists()
        {
            let token = "make one with `monoslam-server token create`";
            writeln!(
                out,
                "{field}: {addr} is reached from other machines, and there is no token yet: {token}"
            )?;
        }
    }
    let (grpc, http) = (config.grpc_addr, config.http_addr);
    writeln!(out, "the configuration can be used: gRPC on {grpc}, HTTP on {http}, {encrypted}")?;
    Ok(())
}

/// A folder that is there can be written, and one that is not can be made.
fn check_folder(config: &Config) -> anyhow::Result<()> {
    let folder = &config.data_dir;
    if folder.exists() {
        ensure!(folder.is_dir(), "data_dir: {} is no folder", folder.display());
        let written = tempfile::tempfile_in(folder);
        written.with_context(|| format!("data_dir: {} cannot be written", folder.display()))?;
        return Ok(());
    }
    let absolute = std::path::absolute(folder)?;
    let above = absolute.ancestors().find(|folder| folder.exists()).context("data_dir leads nowhere")?;
    ensure!(
        above.is_dir(),
        "data_dir: {} cannot be made: {} is no folder",
        folder.display(),
        above.display()
    );
    let written = tempfile::tempfile_in(above);
    written.with_context(|| format!("data_dir: {} cannot be made", folder.display()))?;
    Ok(())
}

fn show(config: &Config, args: &ConfigArgs, out: &mut impl Write) -> anyhow::Result<()> {
    let origins = origins(args)?;
    let fields = fields_of(config)?;
    let mut table = "";
    // Those of no table come first: after a table's head all would be its fields.
    let (inner, outer): (Vec<_>, Vec<_>) = fields.iter().partition(|(name, _)| name.contains('.'));
    for (name, value) in outer.into_iter().chain(inner) {
        let (of, field) = name.rsplit_once('.').unwrap_or(("", name));
        if of != table {
            writeln!(out, "\n[{of}]")?;
            table = of;
        }
        let origin = origins.get(name).unwrap_or(&Origin::Default);
        // What is not set cannot be written in TOML.
        let line = if value.is_null() {
            format!("# {field} is not set")
        } else {
            format!("{field} = {}", without_password(&toml(value)))
        };
        writeln!(out, "{line:<COLUMN$} # {origin}")?;
    }
    if let Ok(filter) = std::env::var(LOG_VARIABLE) {
        writeln!(out, "# {LOG_VARIABLE}={filter} goes before log_filter")?;
    }
    Ok(())
}

/// A URL without the password in it.
fn without_password(text: &str) -> String {
    let hidden = || {
        let (scheme, rest) = text.split_once("://")?;
        let (user, host) = rest.rsplit_once('@')?;
        let (name, _password) = user.split_once(':')?;
        Some(format!("{scheme}://{name}:***@{host}"))
    };
    hidden().unwrap_or_else(|| text.to_owned())
}

/// Numbers, truth values, and lists of strings look the same in JSON; so do strings without control
/// characters, and those are escaped alike.
fn toml(value: &Value) -> String {
    value.to_string()
}

/// Of each field that is not left to its default, where its value comes from.
fn origins(args: &ConfigArgs) -> anyhow::Result<BTreeMap<String, Origin>> {
    let mut origins = BTreeMap::new();
    let mut tables = vec![(String::new(), ValueKind::Table(sources(args)?.collect()?), None)];
    while let Some((name, kind, of)) = tables.pop() {
        if let ValueKind::Table(table) = kind {
            tables.extend(table.into_iter().map(|(key, value)| {
                let of = value.origin().map(str::to_owned);
                (if name.is_empty() { key } else { format!("{name}.{key}") }, value.kind, of)
            }));
            continue;
        }
        let name =
            ALIASES.iter().find(|(_, alias)| *alias == name).map_or(name, |(field, _)| (*field).to_owned());
        let origin = match (of, &args.config) {
            (Some(of), Some(file)) if of != THE_ENVIRONMENT => Origin::File(file.clone()),
            _ => Origin::Environment(format!("MONOSLAM_{}", name.replace('.', "__").to_uppercase())),
        };
        origins.insert(name, origin);
    }
    origins.extend(flags(args).map(|(name, flag)| (name.to_owned(), Origin::Flag(flag))));
    Ok(origins)
}

/// What the crate `config` calls where a variable's value comes from.
const THE_ENVIRONMENT: &str = "the environment";

/// The fields that the command line sets.
fn flags(args: &ConfigArgs) -> impl Iterator<Item = (&'static str, &'static str)> {
    let ConfigArgs { data_dir, grpc_addr, http_addr, tls_cert, tls_key, insecure, log, config: _ } = args;
    let flags = [
        ("data_dir", "--data-dir", data_dir.is_some()),
        ("grpc_addr", "--grpc-addr", grpc_addr.is_some()),
        ("http_addr", "--http-addr", http_addr.is_some()),
        ("tls.cert", "--tls-cert", tls_cert.is_some()),
        ("tls.key", "--tls-key", tls_key.is_some()),
        ("access.insecure", "--insecure", *insecure),
        ("log", "--log", log.is_some()),
    ];
    flags.into_iter().filter(|(_, _, is_given)| *is_given).map(|(field, flag, _)| (field, flag))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(config: &Config, args: &ConfigArgs) -> String {
        let mut out = Vec::new();
        ConfigCommand::Show.run(config, args, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn what_is_shown_can_be_read_again_and_says_where_it_comes_from() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("monoslam.toml");
        let text = "data_dir = \"of \\\"file\\\"\"\n[limits]\nmax_sessions = 3\n[access]\nhosts = [\"maps.example\"]\n\
                    [sessions]\nn_localisations = 2\n";
        std::fs::write(&file, text).unwrap();
        let http_addr = Some("127.0.0.1:81".parse().unwrap());
        let args =
            ConfigArgs { config: Some(file.clone()), http_addr, insecure: true, ..ConfigArgs::default() };
        let config = Config::load(args.clone()).unwrap();
        let text = shown(&config, &args);
        let origin_of = |field: &str| {
            let line = text.lines().find(|line| line.starts_with(&format!("{field} = "))).expect(field);
            line.rsplit_once("# ").expect("an origin").1.to_owned()
        };
        let of_file = format!("file {}", file.display());
        for (field, origin) in [
            ("data_dir", &*of_file),
            ("max_sessions", &of_file),
            ("hosts", &of_file),
            ("n_localizations", &of_file),
            ("http_addr", "flag --http-addr"),
            ("insecure", "flag --insecure"),
            ("grpc_addr", "default"),
            ("idle_unload_s", "default"),
        ] {
            assert_eq!(origin_of(field), origin, "{field} in\n{text}");
        }
        std::fs::write(&file, &text).unwrap();
        let again = Config::load(ConfigArgs { config: Some(file), ..ConfigArgs::default() }).unwrap();
        assert_eq!(again, config, "{text}");
    }

    #[test]
    fn a_check_looks_at_what_the_configuration_names() {
        let folder = tempfile::tempdir().unwrap();
        let of = |config: &Config| {
            let mut out = Vec::new();
            let checked = ConfigCommand::Check.run(config, &ConfigArgs::default(), &mut out);
            checked.map(|()| String::from_utf8(out).unwrap()).map_err(|error| format!("{error:#}"))
        };
        let good = Config::local(folder.path().join("not/there/yet"));
        assert!(of(&good).unwrap().contains("can be used"));
        assert!(!folder.path().join("not").exists(), "a check makes nothing");
        let open = Config { http_addr: "0.0.0.0:0".parse().unwrap(), ..good.clone() };
        assert!(of(&open).unwrap().contains("token create"));
        let elsewhere = Config { grpc_addr: "192.0.2.1:50051".parse().unwrap(), ..good.clone() };
        assert!(of(&elsewhere).unwrap_err().contains("grpc_addr: cannot listen on 192.0.2.1"));
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        for data_dir in [file.clone(), file.join("below")] {
            let error = of(&Config { data_dir, ..good.clone() }).unwrap_err();
            assert!(error.contains("no folder"), "{error}");
        }
        let mut encrypted = good.clone();
        (encrypted.tls.cert, encrypted.tls.key) = (Some(file.clone()), Some(file));
        assert!(of(&encrypted).is_err());
    }
}
