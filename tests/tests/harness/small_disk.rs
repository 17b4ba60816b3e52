//! A disk that can be filled without harm to the machine.

use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::Command;

/// A small disk of its own. Unmounted when dropped.
pub(crate) struct SmallDisk {
    mount_point: tempfile::TempDir,
}

impl SmallDisk {
    /// `None` with a word why where this process may not mount.
    pub(crate) fn mount(size_mib: u32) -> Option<Self> {
        let mount_point = tempfile::tempdir().unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size_mib}m"), "tmpfs"])
            .arg(mount_point.path())
            .output()
            .is_ok_and(|output| output.status.success());
        if !mounted {
            // No other way fills a disk without harm to the machine.
            eprintln!("SKIPPED: this user may not mount a disk to fill");
            return None;
        }
        Some(Self { mount_point })
    }

    /// A folder on it, which is not made yet.
    pub(crate) fn folder(&self) -> PathBuf {
        self.mount_point.path().join("data")
    }

    fn ballast(&self) -> PathBuf {
        self.mount_point.path().join("ballast")
    }

    /// Takes the last byte.
    pub(crate) fn fill(&self) {
        let mut ballast = File::options().append(true).create(true).open(self.ballast()).unwrap();
        for piece in [1 << 16, 1 << 12, 1 << 8, 1] {
            loop {
                match ballast.write_all(&vec![0; piece]) {
                    Ok(()) => {}
                    Err(error) if error.kind() == ErrorKind::StorageFull => break,
                    Err(error) => panic!("{error}"),
                }
            }
        }
    }

    pub(crate) fn free(&self) {
        std::fs::remove_file(self.ballast()).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(self.mount_point.path()).status();
    }
}
