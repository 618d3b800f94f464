//! Databases of PostgreSQL to test with: of a server that all tests of a run share, or of one of a test's
//! own.
//!
//! What is started is what Debian's package `postgresql` installs, in a folder of its own, on a Unix socket;
//! nothing that runs on the machine already is used. Tests that need it are ignored with the reason "needs
//! PostgreSQL".

use std::fs::File;
use std::os::unix::fs::{MetadataExt, chown};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// The superuser of the servers started here.
const USER: &str = "monoslam";

/// Who runs the servers where the tests run as root, which PostgreSQL refuses to do.
const SYSTEM_USER: &str = "postgres";

/// A server that nobody uses for so many seconds ends: another test of the run begins sooner.
const IDLE_S: u32 = 15;

/// How long a server may take to start.
const START_TIMEOUT: Duration = Duration::from_secs(30);

/// Nothing here outlives a test run, so that waiting for the disk would be for nothing.
const SETTINGS: [&str; 4] = ["fsync=off", "listen_addresses=", "shared_buffers=32MB", "max_connections=200"];

/// Whether there is a PostgreSQL to start.
pub fn is_installed() -> bool {
    find_programs().is_some()
}

/// The URL of a new database on the server that all tests share, which is started if there is none.
///
/// # Panics
/// If PostgreSQL is not installed or does not start.
pub fn shared_database() -> String {
    let folder = shared_server();
    let name = format!("t{}_{}", std::process::id(), unique());
    create_database(folder, &name);
    url(folder, &name)
}

/// A server of one test's own, to be stopped and started.
pub struct Cluster {
    folder: TempDir,
    server: Option<Child>,
}

impl Cluster {
    /// Makes one and starts it, with the database that [`Self::url`] names.
    ///
    /// # Panics
    /// If PostgreSQL is not installed or does not start.
    pub fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        give_to_system_user(folder.path());
        init(folder.path());
        let mut cluster = Self { folder, server: None };
        cluster.start_again();
        create_database(cluster.folder.path(), "maps");
        cluster
    }

    /// Its database.
    pub fn url(&self) -> String {
        url(self.folder.path(), "maps")
    }

    /// Starts it after it was stopped or killed.
    pub fn start_again(&mut self) {
        let folder = self.folder.path();
        let mut command = server_command(folder);
        self.server = Some(command.spawn().expect("PostgreSQL starts"));
        wait_for(folder);
    }

    /// Stops it at once, ending every connection; what was committed is there when it starts again.
    pub fn stop(&mut self) {
        let Some(mut server) = self.server.take() else { return };
        let pid = server.id().to_string();
        // SIGINT is a fast shutdown <https://www.postgresql.org/docs/current/server-shutdown.html>.
        Command::new("kill").args(["-INT", &pid]).status().unwrap();
        server.wait().unwrap();
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The folder of the server that all tests share. As long as this process lives the server does.
fn shared_server() -> &'static Path {
    static SHARED: OnceLock<(PathBuf, File)> = OnceLock::new();
    let (folder, _users) = SHARED.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("monoslam-test-postgres-{}", own_uid()));
        std::fs::create_dir_all(&folder).unwrap();
        give_to_system_user(&folder);
        let [users, starting] = ["users", "starting"].map(|name| File::create(folder.join(name)).unwrap());
        users.lock_shared().unwrap();
        starting.lock().unwrap();
        if !answers(&folder) {
            let _ = std::fs::remove_dir_all(folder.join("data"));
            init(&folder);
            look_after(&folder);
            wait_for(&folder);
        }
        starting.unlock().unwrap();
        (folder, users)
    });
    folder
}

/// Starts the server that all tests share, beside what ends it when nobody uses it any more.
fn look_after(folder: &Path) {
    let server = server_command(folder);
    let mut words = vec![server.get_program().to_owned()];
    words.extend(server.get_args().map(std::ffi::OsStr::to_owned));
    // Who begins to use it holds `users` before looking whether it runs, which `starting` is held for.
    let script = format!(
        "\"$@\" & p=$!; n=0
         while kill -0 $p; do
           sleep 1
           if flock -n -x users true; then n=$((n+1)); else n=0; fi
           if [ $n -ge {IDLE_S} ]; then
             exec 9<starting; flock -x 9
             if flock -n -x users true; then kill -INT $p; wait $p; rm -rf data; exit; fi
             exec 9<&-
           fi
         done"
    );
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(script).arg("sh").args(words).current_dir(folder).process_group(0);
    let mut shell = quiet(&mut shell).spawn().expect("a shell starts");
    // It outlives this process, unless tests go on for long.
    std::thread::spawn(move || shell.wait());
}

fn server_command(folder: &Path) -> Command {
    let mut command = Command::new(programs().join("postgres"));
    command.arg("-D").arg(folder.join("data"));
    command.arg("-c").arg(format!("unix_socket_directories={}", folder.display()));
    for setting in SETTINGS {
        command.args(["-c", setting]);
    }
    quiet(&mut command);
    command
}

fn init(folder: &Path) {
    let mut command = Command::new(programs().join("initdb"));
    command.arg("-D").arg(folder.join("data"));
    command.args(["-A", "trust", "-U", USER, "-E", "UTF8", "--locale=C", "--no-sync", "--no-instructions"]);
    assert!(quiet(&mut command).status().unwrap().success(), "initdb fails");
}

fn create_database(folder: &Path, name: &str) {
    let mut command = Command::new(programs().join("createdb"));
    command.arg("-h").arg(folder).args(["-U", USER, "-T", "template0", name]);
    assert!(command.status().unwrap().success(), "createdb fails");
}

fn url(folder: &Path, database: &str) -> String {
    format!("postgres://{USER}@localhost/{database}?host={}", folder.display())
}

/// Without our files and, where we are root, not as root.
fn quiet(command: &mut Command) -> &mut Command {
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if let Some((uid, gid)) = system_user() {
        command.uid(uid).gid(gid);
    }
    command
}

fn answers(folder: &Path) -> bool {
    UnixStream::connect(folder.join(".s.PGSQL.5432")).is_ok()
}

fn wait_for(folder: &Path) {
    let begun = Instant::now();
    loop {
        let mut ready = Command::new(programs().join("pg_isready"));
        ready.arg("-q").arg("-h").arg(folder);
        if ready.status().unwrap().success() {
            return;
        }
        assert!(begun.elapsed() < START_TIMEOUT, "PostgreSQL does not start in {}", folder.display());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn programs() -> &'static Path {
    static PROGRAMS: OnceLock<PathBuf> = OnceLock::new();
    PROGRAMS.get_or_init(|| find_programs().expect("PostgreSQL is installed"))
}

/// Where PostgreSQL's programs are: where Debian puts those of the newest version, or on the path.
fn find_programs() -> Option<PathBuf> {
    let versions = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let mut folders: Vec<PathBuf> = versions.map(|version| version.path().join("bin")).collect();
    folders.sort();
    folders.reverse();
    let path = std::env::var_os("PATH").unwrap_or_default();
    folders.extend(std::env::split_paths(&path));
    let needed = ["initdb", "postgres", "createdb", "pg_isready"];
    folders.into_iter().find(|folder| needed.iter().all(|name| folder.join(name).exists()))
}

fn give_to_system_user(folder: &Path) {
    if let Some((uid, gid)) = system_user() {
        chown(folder, Some(uid), Some(gid)).unwrap();
    }
}

/// Who runs the servers, if not we.
fn system_user() -> Option<(u32, u32)> {
    if own_uid() != 0 {
        return None;
    }
    let users = std::fs::read_to_string("/etc/passwd").unwrap();
    let line = users.lines().find(|line| line.split(':').next() == Some(SYSTEM_USER));
    let mut fields = line.expect("there is a user postgres").split(':').skip(2);
    let mut number = || fields.next().unwrap().parse().unwrap();
    Some((number(), number()))
}

fn own_uid() -> u32 {
    std::fs::metadata("/proc/self").unwrap().uid()
}

fn unique() -> u64 {
    static NEXT: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
    NEXT.fetch_add(1, std::sync::atomic::Ordering::Relaxed)
}
