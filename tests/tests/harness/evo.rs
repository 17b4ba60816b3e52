//! The tool that everybody judges trajectories by: `pip install evo`.

use std::process::Command;

/// Root mean square in metres of how far a trajectory is from the truth, without any alignment, as evo says; both as files
/// of a format that it knows, `tum` or `kitti`. `None`, and a word about it, if it is not there.
pub(crate) fn evo_rmse_m(format: &str, truth: &[u8], trajectory: &[u8]) -> Option<f64> {
    let evo = std::env::var("WAYPOST_EVO").unwrap_or_else(|_| "evo_ape".to_owned());
    if Command::new(&evo).arg("--help").output().is_err() {
        eprintln!("skipped: {evo} is not there; install evo, or name its evo_ape by WAYPOST_EVO");
        return None;
    }
    let directory = tempfile::tempdir().unwrap();
    let [true_file, map_file] = ["truth", "map"].map(|of| directory.path().join(of));
    std::fs::write(&true_file, truth).unwrap();
    std::fs::write(&map_file, trajectory).unwrap();
    let files = [super::path(&true_file), super::path(&map_file)];
    let judged = Command::new(&evo).arg(format).args(files).env("HOME", directory.path()).output().unwrap();
    let said = String::from_utf8_lossy(&judged.stdout).into_owned();
    assert!(judged.status.success(), "{said}{}", String::from_utf8_lossy(&judged.stderr));
    let rmse = said.lines().find_map(|line| line.trim().strip_prefix("rmse")?.trim().parse::<f64>().ok());
    Some(rmse.expect(&said))
}
