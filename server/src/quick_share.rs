//! `--quick-share`: a phone in the same network as this machine's camera, without setting anything up.
//!
//! Browsers give pages a camera over HTTPS only, so the server makes a certificate of its own, which the
//! phone asks its owner about once. The address with a token in it is shown as a QR code. The token is in
//! memory alone, ends with the server, and leads to sessions of the owner `quick-share`.

use crate::access::{new_token, token_hash};
use crate::clock::since_1970_ns;
use crate::config::Config;
use anyhow::Context;
use qrcode::QrCode;
use qrcode::render::unicode::Dense1x2;
use rcgen::{CertificateParams, DistinguishedName, DnType, KeyPair};
use std::fs;
use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use store::{NewToken, TokenQuotas, TokenRecord, TokenRole};

/// Name of the token and of the owner of what is mapped with it.
const NAME: &str = "quick-share";

/// The token is good for a day, should the server run longer.
const TOKEN_LIFETIME: Duration = Duration::from_secs(24 * 3600);

/// A certificate is good for so long: what browsers accept at most.
const CERTIFICATE_LIFETIME: Duration = Duration::from_secs(397 * 24 * 3600);

/// A certificate that is older than this is made anew.
const CERTIFICATE_RENEWAL: Duration = Duration::from_secs(300 * 24 * 3600);

/// No token of a database has this number.
const GUEST_NUMBER: i64 = -1;

/// What a server is shared with.
pub struct QuickShare {
    address: IpAddr,
    token: String,
}

impl QuickShare {
    /// Has a server listen where a phone reaches it, encrypted; with a certificate of its own if none is
    /// configured.
    ///
    /// # Errors
    /// If this machine is in no network, or the certificate cannot be made.
    pub fn prepare(config: &mut Config) -> anyhow::Result<Self> {
        let address = match config.http_addr.ip() {
            ip if ip.is_unspecified() || ip.is_loopback() => own_address()?,
            ip => ip,
        };
        for addr in [&mut config.grpc_addr, &mut config.http_addr] {
            if addr.ip().is_loopback() {
                addr.set_ip(Ipv4Addr::UNSPECIFIED.into());
            }
        }
        if config.tls.cert.is_none() {
            let folder = config.data_dir.join(NAME);
            let (cert, key) = (folder.join("cert.pem"), folder.join("key.pem"));
            if !is_usable(&folder, address) {
                make_certificate(&folder, address)
                    .with_context(|| format!("cannot make a certificate in {}", folder.display()))?;
            }
            (config.tls.cert, config.tls.key) = (Some(cert), Some(key));
        }
        Ok(Self { address, token: new_token() })
    }

    /// The token, for the server.
    pub fn guest(&self) -> TokenRecord {
        let created_at_ns = since_1970_ns();
        let token = NewToken {
            name: NAME.to_owned(),
            hash: token_hash(&self.token),
            role: TokenRole::Writer,
            owner: Some(NAME.to_owned()),
            created_at_ns,
            expires_at_ns: Some(created_at_ns.saturating_add(TOKEN_LIFETIME.as_nanos() as i64)),
            quotas: TokenQuotas::default(),
        };
        TokenRecord { id: GUEST_NUMBER, token, revoked_at_ns: None }
    }

    /// The address to open. The token is behind the `#`, which browsers keep to themselves.
    pub fn url(&self, http_addr: SocketAddr) -> String {
        let host = SocketAddr::new(self.address, http_addr.port());
        format!("https://{host}/capture#token={}", self.token)
    }

    /// What to show to people: a QR code, in colors where `has_colors`, and what it is.
    ///
    /// # Errors
    /// If the address is too long for a code, which none is.
    pub fn invitation(&self, http_addr: SocketAddr, has_colors: bool) -> anyhow::Result<String> {
        let url = self.url(http_addr);
        let code = QrCode::new(&url)?.render::<Dense1x2>().build();
        // Black on white whatever the terminal's colors are: not every phone reads a negative.
        let (black_on_white, normal) = if has_colors { ("\x1b[30;107m", "\x1b[0m") } else { ("", "") };
        let code: String = code.lines().map(|line| format!("{black_on_white}{line}{normal}\n")).collect();
        Ok(format!(
            "{code}\nOpen this address with a phone in the same network, by the code above:\n\n  {url}\n\n\
             The phone will warn that it does not know the certificate, which this server made itself: go on.\n\
             Whoever has this address can map with it until the server ends, for a day at most. The sessions\n\
             belong to the owner `{NAME}`; on this machine they are called `{NAME}~…`.\n"
        ))
    }
}

/// The address by which others in the network reach this machine. Nothing is sent.
fn own_address() -> anyhow::Result<IpAddr> {
    // Of a network that is for documents only (RFC 5737): the way there is the way to everywhere.
    let found = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9)).and_then(|()| socket.local_addr())
    });
    let address = found.map(|addr| addr.ip()).ok().filter(|ip| !ip.is_loopback() && !ip.is_unspecified());
    address.context(
        "this machine seems to be in no network; say by --http-addr at which address a phone reaches it",
    )
}

/// Whether the certificate in the folder is for this address and not too old.
fn is_usable(folder: &Path, address: IpAddr) -> bool {
    let is_of_address =
        fs::read_to_string(folder.join("address")).is_ok_and(|known| known.trim() == address.to_string());
    let age = fs::metadata(folder.join("cert.pem")).and_then(|cert| cert.modified()).ok();
    let age = age.and_then(|made| SystemTime::now().duration_since(made).ok());
    is_of_address && folder.join("key.pem").exists() && age.is_some_and(|age| age < CERTIFICATE_RENEWAL)
}

fn make_certificate(folder: &Path, address: IpAddr) -> anyhow::Result<()> {
    let names = ["localhost".to_owned(), Ipv4Addr::LOCALHOST.to_string(), address.to_string()];
    let mut params = CertificateParams::new(names.to_vec())?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "monoslam quick share");
    let now = rcgen::date_time_ymd(1970, 1, 1) + SystemTime::now().duration_since(UNIX_EPOCH)?;
    // Clocks of phones may be behind.
    params.not_before = now - Duration::from_secs(24 * 3600);
    params.not_after = now + CERTIFICATE_LIFETIME;
    let key = KeyPair::generate()?;
    let cert = params.self_signed(&key)?;
    fs::create_dir_all(folder)?;
    let mut file = fs::OpenOptions::new();
    let file = file.write(true).create(true).truncate(true).mode(0o600).open(folder.join("key.pem"));
    file?.write_all(key.serialize_pem().as_bytes())?;
    fs::write(folder.join("cert.pem"), cert.pem())?;
    Ok(fs::write(folder.join("address"), address.to_string())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::connections::Certificates;

    #[test]
    fn a_certificate_is_made_once_for_each_address_and_can_be_used() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::local(folder.path());
        config.http_addr = "10.9.8.7:443".parse().unwrap();
        let share = QuickShare::prepare(&mut config).unwrap();
        assert!(config.grpc_addr.ip().is_unspecified() && config.http_addr.ip() == share.address);
        Certificates::of(&config.tls).unwrap().expect("a certificate");
        let read = |config: &Config| fs::read(config.tls.cert.as_ref().unwrap()).unwrap();
        let first = read(&config);
        let again = |address: &str| {
            let mut config = Config::local(folder.path());
            config.http_addr = address.parse().unwrap();
            QuickShare::prepare(&mut config).unwrap();
            read(&config)
        };
        assert!(again("10.9.8.7:443") == first, "the phone would have to be asked again");
        assert!(again("10.9.8.6:443") != first);
    }

    #[test]
    fn the_invitation_shows_the_address() {
        let share = QuickShare { address: "10.0.0.7".parse().unwrap(), token: "monoslam_x".into() };
        let text = share.invitation("0.0.0.0:8080".parse().unwrap(), false).unwrap();
        assert!(text.contains("https://10.0.0.7:8080/capture#token=monoslam_x"));
        assert!(text.lines().filter(|line| line.contains('█')).count() > 10, "{text}");
    }
}
