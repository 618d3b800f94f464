//! Bag files of ROS 1, version 2.0: records of named fields and data, most of them packed into chunks.

use std::collections::HashMap;
use std::io::{BufRead, Cursor, Read};

use super::MAX_BYTES;
use super::container::{Damage, MessageKind, RosMessage};
use super::fields::Encoding;

/// How such a file begins.
pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// Largest set of fields of a record, bytes; they are a few names and numbers, but of a connection the
/// definition of its messages.
const MAX_FIELDS: usize = 1 << 20;

/// Connections that are kept; a robot has hundreds of topics.
const MAX_CONNECTIONS: usize = 1 << 16;

/// Kinds of records that are read; the others are an index.
const MESSAGE: u8 = 2;
const CHUNK: u8 = 5;
const CONNECTION: u8 = 7;

/// Topic and kind of the messages of a connection; `None` if they are not understood.
type Connection = Option<(String, MessageKind)>;

/// Reads a file from its beginning to its end.
pub(super) struct Ros1Reader<R> {
    file: R,
    /// The chunk that is read.
    chunk: Option<Cursor<Vec<u8>>>,
    connections: HashMap<u32, Connection>,
}

/// A record: its fields and how many bytes of data follow.
struct Record {
    fields: Vec<u8>,
    n_bytes: usize,
}

impl<R: BufRead> Ros1Reader<R> {
    /// Behind the first line, which is checked.
    pub(super) fn new(mut file: R) -> Result<Self, Damage> {
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic)?;
        if magic != MAGIC {
            return Err(Damage::content("it does not begin as a bag of version 2.0 does"));
        }
        Ok(Self { file, chunk: None, connections: HashMap::new() })
    }

    /// The next message that is understood and wanted by its kind and topic.
    pub(super) fn next(
        &mut self,
        is_wanted: impl Fn(MessageKind, &str) -> bool,
    ) -> Result<Option<RosMessage>, Damage> {
        loop {
            // A chunk ends where its data does, the file where a record would begin.
            if let Some(chunk) = &mut self.chunk {
                if chunk.fill_buf()?.is_empty() {
                    self.chunk = None;
                    continue;
                }
                let record = Record::read(chunk).map_err(in_chunk)?;
                let message = take(&mut self.connections, &record, chunk, &is_wanted).map_err(in_chunk)?;
                if message.is_some() {
                    return Ok(message);
                }
                continue;
            }
            if self.file.fill_buf()?.is_empty() {
                return Ok(None);
            }
            let record = Record::read(&mut self.file)?;
            if record.op()? == CHUNK {
                self.chunk = Some(Cursor::new(unpacked(&record, &mut self.file)?));
                continue;
            }
            let message = take(&mut self.connections, &record, &mut self.file, &is_wanted)?;
            if message.is_some() {
                return Ok(message);
            }
        }
    }
}

/// What ends early inside a chunk is not a file that ends early.
fn in_chunk(damage: Damage) -> Damage {
    match damage {
        Damage::EndsEarly => Damage::content("a chunk ends in the middle of a record"),
        damage => damage,
    }
}

impl Record {
    fn read(from: &mut impl Read) -> Result<Self, Damage> {
        let n_field_bytes = read_length(from)?;
        if n_field_bytes > MAX_FIELDS {
            return Err(Damage::content(format!("the fields of a record have {n_field_bytes} bytes")));
        }
        let fields = read_bytes(from, n_field_bytes)?;
        let n_bytes = read_length(from)?;
        if n_bytes > MAX_BYTES {
            return Err(Damage::content(format!("a record has {n_bytes} bytes, more than are read")));
        }
        Ok(Self { fields, n_bytes })
    }

    /// What kind of record it is.
    fn op(&self) -> Result<u8, Damage> {
        match self.field(b"op")? {
            [op] => Ok(*op),
            _ => Err(Damage::content("the kind of a record is not one byte")),
        }
    }

    fn field(&self, name: &[u8]) -> Result<&[u8], Damage> {
        find_field(&self.fields, name)?
            .ok_or_else(|| Damage::content(format!("a record has no `{}`", String::from_utf8_lossy(name))))
    }

    fn number(&self, name: &[u8]) -> Result<u32, Damage> {
        let bytes = self.field(name)?.try_into();
        bytes.map(u32::from_le_bytes).map_err(|_| {
            Damage::content(format!("`{}` of a record is not four bytes", String::from_utf8_lossy(name)))
        })
    }

    fn time_ns(&self) -> Result<i64, Damage> {
        match self.field(b"time")? {
            &[a, b, c, d, e, f, g, h] => {
                let seconds = i64::from(u32::from_le_bytes([a, b, c, d]));
                Ok(1_000_000_000 * seconds + i64::from(u32::from_le_bytes([e, f, g, h])))
            }
            _ => Err(Damage::content("the time of a message is not eight bytes")),
        }
    }
}

/// The field of that name among fields that stand one after the other.
fn find_field<'a>(mut fields: &'a [u8], name: &[u8]) -> Result<Option<&'a [u8]>, Damage> {
    let cut = || Damage::content("the fields of a record are cut");
    while !fields.is_empty() {
        let (length, rest) = fields.split_first_chunk().ok_or_else(cut)?;
        let length = usize::try_from(u32::from_le_bytes(*length)).map_err(|_| cut())?;
        let (field, rest) = rest.split_at_checked(length).ok_or_else(cut)?;
        if let Some(value) = field.strip_prefix(name).and_then(|value| value.strip_prefix(b"=")) {
            return Ok(Some(value));
        }
        fields = rest;
    }
    Ok(None)
}

/// Takes in a record that is no chunk, with its data.
fn take(
    connections: &mut HashMap<u32, Connection>,
    record: &Record,
    from: &mut impl BufRead,
    is_wanted: &impl Fn(MessageKind, &str) -> bool,
) -> Result<Option<RosMessage>, Damage> {
    match record.op()? {
        CONNECTION => {
            let data = read_bytes(from, record.n_bytes)?;
            let kind = find_field(&data, b"type")?.and_then(|name| std::str::from_utf8(name).ok());
            let kind = kind.and_then(MessageKind::of_type);
            let topic = String::from_utf8_lossy(record.field(b"topic")?).into_owned();
            if connections.len() == MAX_CONNECTIONS {
                return Err(Damage::content("it has more connections than a robot"));
            }
            connections.insert(record.number(b"conn")?, kind.map(|kind| (topic, kind)));
            Ok(None)
        }
        MESSAGE => {
            let connection = connections.get(&record.number(b"conn")?);
            let connection =
                connection.ok_or_else(|| Damage::content("a message is of a connection that is not told"))?;
            let wanted = connection.as_ref().filter(|(topic, kind)| is_wanted(*kind, topic));
            let Some((topic, kind)) = wanted else {
                pass_over(from, record.n_bytes)?;
                return Ok(None);
            };
            let (topic, kind, log_time_ns) = (topic.clone(), *kind, record.time_ns()?);
            let data = read_bytes(from, record.n_bytes)?;
            Ok(Some(RosMessage { topic, kind, encoding: Encoding::Ros1, log_time_ns, data }))
        }
        CHUNK => Err(Damage::content("a chunk is inside another")),
        _ => {
            pass_over(from, record.n_bytes)?;
            Ok(None)
        }
    }
}

/// The records of a chunk.
fn unpacked(record: &Record, from: &mut impl Read) -> Result<Vec<u8>, Damage> {
    let packed = read_bytes(from, record.n_bytes)?;
    let size = usize::try_from(record.number(b"size")?).unwrap_or(usize::MAX);
    if size > MAX_BYTES {
        return Err(Damage::content(format!("a chunk unpacks to {size} bytes, more than are read")));
    }
    let unpacked = match record.field(b"compression")? {
        b"none" => packed,
        b"bz2" => unpack(bzip2::read::BzDecoder::new(&packed[..]), size)?,
        b"lz4" => {
            let decoder =
                lz4::Decoder::new(&packed[..]).map_err(|error| Damage::content(error.to_string()))?;
            unpack(decoder, size)?
        }
        other => {
            let name = String::from_utf8_lossy(other).into_owned();
            return Err(Damage::content(format!("chunks are packed by `{name}`, not by bz2, lz4 or none")));
        }
    };
    if unpacked.len() != size {
        return Err(Damage::content("a chunk unpacks to another size than it says"));
    }
    Ok(unpacked)
}

/// Unpacks no more than one byte above what is expected.
fn unpack(decoder: impl Read, size: usize) -> Result<Vec<u8>, Damage> {
    let mut unpacked = Vec::new();
    let read = decoder.take(size as u64 + 1).read_to_end(&mut unpacked);
    read.map_err(|error| Damage::content(format!("a chunk cannot be unpacked: {error}")))?;
    Ok(unpacked)
}

fn read_length(from: &mut impl Read) -> Result<usize, Damage> {
    let mut bytes = [0; 4];
    from.read_exact(&mut bytes)?;
    Ok(usize::try_from(u32::from_le_bytes(bytes)).unwrap_or(usize::MAX))
}

/// Reads so many bytes, without memory for those that a damaged file only claims to have.
fn read_bytes(from: &mut impl Read, n: usize) -> Result<Vec<u8>, Damage> {
    let mut bytes = Vec::new();
    from.take(n as u64).read_to_end(&mut bytes)?;
    if bytes.len() < n { Err(Damage::EndsEarly) } else { Ok(bytes) }
}

fn pass_over(from: &mut impl BufRead, mut n: usize) -> Result<(), Damage> {
    while n > 0 {
        let n_there = from.fill_buf()?.len().min(n);
        if n_there == 0 {
            return Err(Damage::EndsEarly);
        }
        from.consume(n_there);
        n -= n_there;
    }
    Ok(())
}
