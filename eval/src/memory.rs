//! Memory of this process, as Linux tells it.

/// Memory that is not swapped out, in MiB; `None` where the system does not tell.
pub(crate) fn resident_mib() -> Option<f64> {
    status_mib("VmRSS:")
}

/// The most memory that was held so far, in MiB; `None` where the system does not tell.
pub(crate) fn peak_mib() -> Option<f64> {
    status_mib("VmHWM:")
}

fn status_mib(field: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_at_least_what_is_held() {
        let resident = resident_mib().unwrap();
        let peak = peak_mib().unwrap();
        assert!(resident > 0.0 && peak >= resident, "{resident} {peak}");
    }
}
