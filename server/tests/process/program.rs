//! The server as a program.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use tests::Client;

pub const SERVER: &str = env!("CARGO_BIN_EXE_monoslam-server");

/// A server in a process of its own.
pub struct ServerProcess {
    child: Child,
    pub grpc_addr: SocketAddr,
    pub http_addr: SocketAddr,
}

impl ServerProcess {
    /// Starts a server and waits until it serves.
    pub fn start(data_dir: &Path) -> Self {
        Self::start_with(data_dir, |_| {})
    }

    /// As [`Self::start`], with more arguments or another environment.
    pub fn start_with(data_dir: &Path, change: impl FnOnce(&mut Command)) -> Self {
        Self::start_at("127.0.0.1", data_dir, change)
    }

    /// As [`Self::start_with`], at another of the machine's addresses.
    pub fn start_at(host: &str, data_dir: &Path, change: impl FnOnce(&mut Command)) -> Self {
        let (mut command, address) = (Command::new(SERVER), format!("{host}:0"));
        command.args(["--grpc-addr", &address, "--http-addr", &address, "--data-dir"]);
        change(command.arg(data_dir));
        let mut child =
            command.env("RUST_LOG", "info").stderr(Stdio::piped()).spawn().expect("the server starts");
        let mut log = BufReader::new(child.stderr.take().expect("a log")).lines();
        let addresses = log.by_ref().map_while(Result::ok).find_map(|line| addresses_in(&line));
        let (grpc_addr, http_addr) = addresses.expect("the server says where it serves");
        // The rest of the log is read so that the server never waits for us.
        std::thread::spawn(move || log.for_each(drop));
        Self { child, grpc_addr, http_addr }
    }

    pub async fn client(&self) -> Client {
        tests::connect(self.grpc_addr).await.expect("the server takes connections")
    }

    /// Memory that the process takes now.
    pub fn resident_bytes(&self) -> u64 {
        let text = std::fs::read_to_string(format!("/proc/{}/statm", self.child.id())).expect("it runs");
        let n_pages: u64 = text.split(' ').nth(1).and_then(|n| n.parse().ok()).expect("a number of pages");
        // SAFETY: asks for a constant.
        n_pages * unsafe { libc::sysconf(libc::_SC_PAGESIZE) } as u64
    }

    /// SIGKILL.
    pub fn kill(mut self) {
        self.child.kill().expect("the server was running");
        self.child.wait().expect("the server has ended");
    }

    /// Sends the server a signal.
    pub fn signal(&self, signal: libc::c_int) {
        // SAFETY: sends a signal to a child that was not waited for yet, so that its number is still its own.
        let sent = unsafe { libc::kill(self.child.id() as libc::pid_t, signal) };
        assert_eq!(sent, 0);
    }

    /// SIGTERM; whether the server ended well.
    pub fn terminate(mut self) -> bool {
        self.signal(libc::SIGTERM);
        self.child.wait().expect("the server ends").success()
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// Reads `serving gRPC on A and HTTP on B`.
fn addresses_in(line: &str) -> Option<(SocketAddr, SocketAddr)> {
    let (_, rest) = line.split_once("serving gRPC on ")?;
    let (grpc, rest) = rest.split_once(" and HTTP on ")?;
    let http = rest.split_whitespace().next()?.trim_end_matches(',');
    Some((grpc.parse().ok()?, http.parse().ok()?))
}

/// Ends what a server writes to a file at so many bytes, as a disk that is full does.
pub fn limit_files(command: &mut Command, n_bytes: u64) {
    use std::os::unix::process::CommandExt;
    let limit = move || {
        let limit = libc::rlimit { rlim_cur: n_bytes, rlim_max: n_bytes };
        // SAFETY: both calls are safe between fork and exec. Without the signal writing fails instead.
        let set = unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            libc::setrlimit(libc::RLIMIT_FSIZE, &limit)
        };
        if set == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
    };
    // SAFETY: the closure allocates nothing and takes no lock.
    unsafe { command.pre_exec(limit) };
}

/// Runs the program with these arguments.
pub fn run<A: AsRef<std::ffi::OsStr>>(arguments: &[A]) -> Output {
    Command::new(SERVER).args(arguments).output().expect("the program runs")
}

/// What a program said, on both of its outputs.
pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// What the server's own check says of a database.
pub fn check(data_dir: &Path) -> String {
    let output = run(&["check".as_ref(), "--data-dir".as_ref(), data_dir.as_os_str()]);
    assert!(output.status.success(), "the database is not whole: {}", said(&output));
    said(&output)
}
