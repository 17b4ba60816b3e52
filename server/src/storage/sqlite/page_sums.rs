//! A checksum on every page of the database file, made and verified below SQLite.
//!
//! SQLite leaves the last bytes of a page to those who ask for them. Here they hold a checksum of the page and of its
//! number, made when the page is written to the file and verified whenever it is read from there: so rot shows in tables
//! and indices alike, and so does a page that was written to another's place. SQLite's own checksum module works like
//! this; it is not part of the SQLite that is linked. The write-ahead log has checksums of SQLite's own.
#![allow(unsafe_code, reason = "SQLite calls a file system through its C interface")]

use std::ffi::{CStr, c_char, c_int, c_void};
use std::sync::OnceLock;

use libsqlite3_sys as sqlite;
use libsqlite3_sys::{sqlite3_file, sqlite3_io_methods, sqlite3_vfs};
use sqlx::SqliteConnection;

use crate::storage::StorageError;

/// What connections open the file with.
pub(super) const VFS: &str = "waypost";
const C_VFS: &CStr = c"waypost";

/// Bytes of a page. Databases of earlier versions have pages of that size, too: it is SQLite's own choice.
pub(super) const PAGE_BYTES: usize = 4096;

/// What of them is the checksum's.
pub(super) const SUM_BYTES: usize = 8;

/// Where the first page says how large pages are.
const PAGE_BYTES_AT: usize = 16;

/// Where the first page says how much of each page SQLite leaves alone.
pub(super) const RESERVED_AT: usize = 20;

/// The beginning of the first page, which SQLite reads alone at first.
const HEADER_BYTES: usize = 100;

/// What a page has in place of a checksum that another program wrote.
pub(super) const NO_SUM: [u8; SUM_BYTES] = [0; SUM_BYTES];

/// A page's checksum, by its number, from 1, and all but its last bytes.
pub(super) fn sum(number: u32, content: &[u8]) -> [u8; SUM_BYTES] {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&number.to_le_bytes());
    hasher.update(content);
    let mut sum = [0; SUM_BYTES];
    sum[..4].copy_from_slice(&hasher.finalize().to_le_bytes());
    sum[4..].copy_from_slice(&number.to_le_bytes());
    sum
}

/// Whether a page is as it was written.
pub(super) fn is_sound(number: u32, page: &[u8]) -> bool {
    let Some((content, found)) = page.split_last_chunk::<SUM_BYTES>() else { return false };
    sum(number, content) == *found
}

/// The number of the page that begins at `offset`, if bytes read or written there are a whole one.
fn page_number(offset: i64, bytes: usize) -> Option<u32> {
    let offset = usize::try_from(offset).ok()?;
    let whole = bytes == PAGE_BYTES && offset.is_multiple_of(PAGE_BYTES);
    u32::try_from(offset / PAGE_BYTES + 1).ok().filter(|_| whole)
}

/// Whether what was read of the file may be used.
fn may_be_used(offset: i64, bytes: &[u8]) -> bool {
    let Some(number) = page_number(offset, bytes.len()) else { return true };
    let sound = is_sound(number, bytes);
    if !sound && bytes.ends_with(&NO_SUM) {
        tracing::error!(
            page = number,
            "a page of the database has no checksum: another program wrote it, or it was lost"
        );
    } else if !sound {
        tracing::error!(page = number, "a page of the database is not as it was written");
    }
    sound
}

/// What SQLite reads alone of the first page says how large pages are, and no checksum is there to hold it to. All that have
/// checksums are alike: so it is told that, whatever is there. The page itself is read later, whole, or is in the
/// write-ahead log where it was not written whole.
fn say_how_pages_are(offset: i64, bytes: &mut [u8]) {
    if offset == 0 && (HEADER_BYTES..PAGE_BYTES).contains(&bytes.len()) {
        bytes[PAGE_BYTES_AT..PAGE_BYTES_AT + 2].copy_from_slice(&(PAGE_BYTES as u16).to_be_bytes());
        bytes[RESERVED_AT] = SUM_BYTES as u8;
    }
}

/// The file system beneath.
struct Beneath(*mut sqlite3_vfs);

// SAFETY: SQLite's own file system is registered once and lives as long as the process; all threads use it.
unsafe impl Send for Beneath {}
// SAFETY: as above.
unsafe impl Sync for Beneath {}

static BENEATH: OnceLock<Option<Beneath>> = OnceLock::new();

/// Makes [`VFS`] known to SQLite, once in a process.
pub(super) fn register() -> Result<(), StorageError> {
    let registered = BENEATH.get_or_init(|| {
        // SAFETY: `sqlite3_vfs_find` gives the default file system or null. The copy is leaked, as one that is registered
        // must be; all but its name, its size of a file and its way to open one stay what they are.
        unsafe {
            let beneath = sqlite::sqlite3_vfs_find(std::ptr::null());
            let own = Box::leak(Box::new(*beneath.as_ref()?));
            own.zName = C_VFS.as_ptr();
            own.pNext = std::ptr::null_mut();
            own.szOsFile += size_of::<sqlite3_file>() as c_int;
            own.xOpen = Some(open);
            (sqlite::sqlite3_vfs_register(own, 0) == sqlite::SQLITE_OK).then_some(Beneath(beneath))
        }
    });
    match registered {
        Some(_) => Ok(()),
        None => Err(StorageError::Damaged("SQLite, which has no file system on this machine".to_owned())),
    }
}

/// Asks SQLite to leave room for checksums in a database that it is about to write for the first time, or anew.
pub(super) async fn reserve(connection: &mut SqliteConnection) -> Result<(), StorageError> {
    let mut handle = connection.lock_handle().await?;
    let mut bytes = SUM_BYTES as c_int;
    // SAFETY: the handle is that of an open connection which is locked meanwhile; the call reads and writes one integer.
    let done = unsafe {
        let bytes = std::ptr::from_mut(&mut bytes).cast::<c_void>();
        let connection = handle.as_raw_handle().as_ptr();
        sqlite::sqlite3_file_control(connection, std::ptr::null(), sqlite::SQLITE_FCNTL_RESERVE_BYTES, bytes)
    };
    match done {
        sqlite::SQLITE_OK => Ok(()),
        code => {
            Err(StorageError::Damaged(format!("a page without room for a checksum (SQLite says {code})")))
        }
    }
}

/// Opens a database's file with checksums, and any other without.
///
/// # Safety
/// SQLite calls it with room for `szOsFile` bytes at `file`.
unsafe extern "C" fn open(
    _own: *mut sqlite3_vfs,
    name: *const c_char,
    file: *mut sqlite3_file,
    flags: c_int,
    flags_out: *mut c_int,
) -> c_int {
    let Some(Some(Beneath(vfs))) = BENEATH.get() else { return sqlite::SQLITE_CANTOPEN };
    // SAFETY: what SQLite gave is passed on; behind our own `sqlite3_file` there is room for the one beneath.
    unsafe {
        let Some(open) = (**vfs).xOpen else { return sqlite::SQLITE_CANTOPEN };
        let methods = if flags & sqlite::SQLITE_OPEN_MAIN_DB == 0 { &OTHER_FILES } else { &METHODS };
        (*file).pMethods = std::ptr::null();
        let opened = open(*vfs, name, beneath(file), flags, flags_out);
        // Also after a failure: SQLite closes what has methods.
        if !(*beneath(file)).pMethods.is_null() {
            (*file).pMethods = methods;
        }
        opened
    }
}

/// The file beneath, which lies behind ours.
///
/// # Safety
/// `file` was opened by [`open`].
unsafe fn beneath(file: *mut sqlite3_file) -> *mut sqlite3_file {
    // SAFETY: there is room for it, as `szOsFile` asked for.
    unsafe { file.add(1) }
}

/// A read that fails is no damage: SQLite would call it that, and what it calls so is taken to be lost. The disk may be well
/// again with the next read.
unsafe extern "C" fn read_as_it_is(
    file: *mut sqlite3_file,
    bytes: *mut c_void,
    count: c_int,
    offset: i64,
) -> c_int {
    // SAFETY: what SQLite gave is passed on.
    match unsafe { read_beneath(file, bytes, count, offset) } {
        sqlite::SQLITE_IOERR_CORRUPTFS => {
            tracing::error!(
                offset,
                "the disk cannot read the database; if that goes on, look at the disk and bring back a backup"
            );
            sqlite::SQLITE_IOERR_READ
        }
        status => status,
    }
}

unsafe extern "C" fn read(file: *mut sqlite3_file, bytes: *mut c_void, count: c_int, offset: i64) -> c_int {
    // SAFETY: SQLite gives `count` bytes to write to, and they are written when the read is well.
    unsafe {
        let status = read_as_it_is(file, bytes, count, offset);
        if status != sqlite::SQLITE_OK {
            return status;
        }
        let read = std::slice::from_raw_parts_mut(bytes.cast::<u8>(), usize::try_from(count).unwrap_or(0));
        if !may_be_used(offset, read) {
            return sqlite::SQLITE_IOERR_DATA;
        }
        say_how_pages_are(offset, read);
        // In SQLite's memory and in its write-ahead log pages have no checksum: one that another program folds into the
        // file is told apart from one that has rotted.
        if page_number(offset, read.len()).is_some()
            && let Some((_, room)) = read.split_last_chunk_mut::<SUM_BYTES>()
        {
            *room = NO_SUM;
        }
        sqlite::SQLITE_OK
    }
}

unsafe extern "C" fn write(
    file: *mut sqlite3_file,
    bytes: *const c_void,
    count: c_int,
    offset: i64,
) -> c_int {
    let count_bytes = usize::try_from(count).unwrap_or(0);
    let Some(number) = page_number(offset, count_bytes) else {
        // SAFETY: what SQLite gave is passed on.
        return unsafe { write_beneath(file, bytes, count, offset) };
    };
    // SQLite's own copy is not ours to change.
    let mut page = [0; PAGE_BYTES];
    // SAFETY: SQLite gives `count` bytes, which is a page.
    unsafe {
        page.copy_from_slice(std::slice::from_raw_parts(bytes.cast::<u8>(), PAGE_BYTES));
        let (content, room) = page.split_at_mut(PAGE_BYTES - SUM_BYTES);
        room.copy_from_slice(&sum(number, content));
        write_beneath(file, page.as_ptr().cast(), count, offset)
    }
}

/// What the file beneath is like, but for reading parts of pages: those would pass by the checksums.
unsafe extern "C" fn device_characteristics(file: *mut sqlite3_file) -> c_int {
    // SAFETY: what SQLite gave is passed on.
    unsafe { device_beneath(file) & !sqlite::SQLITE_IOCAP_SUBPAGE_READ }
}

/// Functions that ask the file beneath.
macro_rules! passed_on {
    ($($name:ident = $method:ident($($argument:ident: $kind:ty),*) -> $answer:ty, or $without:expr;)*) => {$(
        unsafe extern "C" fn $name(file: *mut sqlite3_file, $($argument: $kind),*) -> $answer {
            // SAFETY: what SQLite gave for a file that is open is passed on to the one beneath.
            unsafe {
                let file = beneath(file);
                match (*(*file).pMethods).$method {
                    Some(method) => method(file, $($argument),*),
                    None => $without,
                }
            }
        }
    )*};
}

passed_on! {
    close = xClose() -> c_int, or sqlite::SQLITE_OK;
    read_beneath = xRead(bytes: *mut c_void, count: c_int, offset: i64) -> c_int, or sqlite::SQLITE_IOERR;
    write_beneath = xWrite(bytes: *const c_void, count: c_int, offset: i64) -> c_int, or sqlite::SQLITE_IOERR;
    truncate = xTruncate(size: i64) -> c_int, or sqlite::SQLITE_IOERR;
    sync = xSync(flags: c_int) -> c_int, or sqlite::SQLITE_IOERR;
    file_size = xFileSize(size: *mut i64) -> c_int, or sqlite::SQLITE_IOERR;
    lock = xLock(level: c_int) -> c_int, or sqlite::SQLITE_IOERR;
    unlock = xUnlock(level: c_int) -> c_int, or sqlite::SQLITE_IOERR;
    check_reserved_lock = xCheckReservedLock(held: *mut c_int) -> c_int, or sqlite::SQLITE_IOERR;
    file_control = xFileControl(what: c_int, value: *mut c_void) -> c_int, or sqlite::SQLITE_NOTFOUND;
    sector_size = xSectorSize() -> c_int, or 0;
    device_beneath = xDeviceCharacteristics() -> c_int, or 0;
    shared_map = xShmMap(region: c_int, size: c_int, extend: c_int, mapped: *mut *mut c_void) -> c_int,
        or sqlite::SQLITE_IOERR;
    shared_lock = xShmLock(first: c_int, count: c_int, flags: c_int) -> c_int, or sqlite::SQLITE_IOERR;
    shared_barrier = xShmBarrier() -> (), or ();
    shared_unmap = xShmUnmap(delete: c_int) -> c_int, or sqlite::SQLITE_OK;
}

/// Without those of version 3: pages that are mapped into memory would pass by the checksums.
const SUMMED: sqlite3_io_methods = sqlite3_io_methods {
    iVersion: 2,
    xClose: Some(close),
    xRead: Some(read),
    xWrite: Some(write),
    xTruncate: Some(truncate),
    xSync: Some(sync),
    xFileSize: Some(file_size),
    xLock: Some(lock),
    xUnlock: Some(unlock),
    xCheckReservedLock: Some(check_reserved_lock),
    xFileControl: Some(file_control),
    xSectorSize: Some(sector_size),
    xDeviceCharacteristics: Some(device_characteristics),
    xShmMap: Some(shared_map),
    xShmLock: Some(shared_lock),
    xShmBarrier: Some(shared_barrier),
    xShmUnmap: Some(shared_unmap),
    xFetch: None,
    xUnfetch: None,
};

static METHODS: sqlite3_io_methods = SUMMED;

/// Of the write-ahead log and of journals, which have checksums of SQLite's own.
static OTHER_FILES: sqlite3_io_methods =
    sqlite3_io_methods { xRead: Some(read_as_it_is), xWrite: Some(write_beneath), ..SUMMED };
