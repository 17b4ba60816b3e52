//! What the process takes, and memory that is no longer needed going back to the system.

use crate::metrics::ProcessLevels;

/// What Linux counts processor time in.
const TICKS_PER_SECOND: f64 = 100.0;

/// What was freed in many small pieces, as by the decoding of images, stays with this process unless it is told to give
/// that back.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "the C library has no safe name for it")]
pub(crate) fn give_back() {
    // SAFETY: it takes no pointer, may be called from any thread at any time, and moves nothing that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Other C libraries do so by themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn give_back() {}

/// Has all threads allocate in as many heaps as there are cores. The C library would make up to eight times as many, and what
/// is freed in one of them is of no use to the threads of another.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "the C library has no safe name for it")]
pub fn share_heaps() {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    // SAFETY: it takes no pointer, and may be called from any thread at any time.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, i32::try_from(cores).unwrap_or(i32::MAX));
    }
}

/// Other C libraries have none to share.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn share_heaps() {}

/// What the process takes by now, as Linux tells it.
pub(crate) fn process_levels() -> ProcessLevels {
    let read = |file: &str| std::fs::read_to_string(file).unwrap_or_default();
    ProcessLevels {
        resident_bytes: resident_kib(&read("/proc/self/status")).map(|kib| kib * 1024),
        cpu_seconds: cpu_ticks(&read("/proc/self/stat")).map(|ticks| ticks as f64 / TICKS_PER_SECOND),
    }
}

fn resident_kib(status: &str) -> Option<u64> {
    status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?
        .trim()
        .strip_suffix("kB")?
        .trim()
        .parse()
        .ok()
}

/// User and system time of `stat`, its 14th and 15th field; the second, a name in brackets, may have blanks.
fn cpu_ticks(stat: &str) -> Option<u64> {
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let [user, system] = [fields.next()?, fields.next()?];
    Some(user.parse::<u64>().ok()? + system.parse::<u64>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linux_tells_what_a_process_takes() {
        assert_eq!(resident_kib("Name:\twaypost\nVmRSS:\t   5120 kB\nVmData:\t 1 kB\n"), Some(5120));
        let stat = "7 (a (b) c) S 1 7 7 0 -1 4194304 100 0 0 0 250 31 0 0 20 0 1 0 5 6 7";
        assert_eq!(cpu_ticks(stat), Some(281));
        assert_eq!((resident_kib(""), cpu_ticks("7 (a")), (None, None));
    }
}
