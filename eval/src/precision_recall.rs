//! Precision and recall of proposals, swept over the threshold on their score.

use serde::Serialize;

use crate::dataset::Verdict;

/// The curve of precision over recall, from the highest threshold to the lowest.
///
/// Proposals of one score pass the threshold together: there is one operating point per different
/// score, and no result depends on how equal scores happen to be ordered.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PrecisionRecall {
    /// One point per different score, highest threshold first.
    pub(crate) points: Vec<OperatingPoint>,
    /// Frames that have a loop.
    pub(crate) queries_with_loop: usize,
}

/// What passes a threshold: all proposals with at least this score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct OperatingPoint {
    /// The lowest score that passes.
    pub threshold: f64,
    /// Proposals that are loops.
    pub true_proposals: usize,
    /// Proposals that are not.
    pub false_proposals: usize,
    /// Proposals that are counted neither way.
    pub neutral_proposals: usize,
}

/// A proposal with what the truth says of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JudgedProposal {
    /// The system's own score; higher is surer.
    pub score: f64,
    /// What the truth says.
    pub verdict: Verdict,
}

impl PrecisionRecall {
    /// Sweeps the threshold over all scores; `queries_with_loop` frames have a loop.
    pub(crate) fn sweep(mut proposals: Vec<JudgedProposal>, queries_with_loop: usize) -> Self {
        proposals.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut passed =
            OperatingPoint { threshold: 0.0, true_proposals: 0, false_proposals: 0, neutral_proposals: 0 };
        let mut points = Vec::new();
        for of_one_score in proposals.chunk_by(|a, b| a.score == b.score) {
            for proposal in of_one_score {
                passed.threshold = proposal.score;
                match proposal.verdict {
                    Verdict::True => passed.true_proposals += 1,
                    Verdict::False => passed.false_proposals += 1,
                    Verdict::Neutral => passed.neutral_proposals += 1,
                }
            }
            points.push(passed);
        }
        Self { points, queries_with_loop }
    }

    /// Share of the frames with a loop that got a true proposal at this point; `None` if there is
    /// no frame with a loop.
    pub(crate) fn recall(&self, point: &OperatingPoint) -> Option<f64> {
        (self.queries_with_loop > 0).then(|| point.true_proposals as f64 / self.queries_with_loop as f64)
    }

    /// The largest recall at which no false proposal passes; 0 if the best score is a false
    /// proposal's (a true one of the same score does not help); `None` if there is no frame with a
    /// loop.
    pub(crate) fn recall_at_100_precision(&self) -> Option<f64> {
        let clean = self.points.iter().take_while(|point| point.false_proposals == 0).last();
        match clean {
            Some(point) => self.recall(point),
            None => (self.queries_with_loop > 0).then_some(0.0),
        }
    }

    /// Σ_k (R_k − R_{k−1}) P_k over the operating points k: the mean, over all frames with a loop,
    /// of the precision at the threshold that their true proposal just passes, 0 for those without
    /// one. With no equal scores it is the sum of the precisions at every true proposal divided by
    /// the number of frames with a loop. `None` if there is no frame with a loop.
    pub(crate) fn average_precision(&self) -> Option<f64> {
        let mut sum = 0.0;
        let mut before = 0;
        for point in &self.points {
            sum += (point.true_proposals - before) as f64 * point.precision();
            before = point.true_proposals;
        }
        (self.queries_with_loop > 0).then(|| sum / self.queries_with_loop as f64)
    }

    /// What passes if every proposal does.
    pub(crate) fn unthresholded(&self) -> Option<&OperatingPoint> {
        self.points.last()
    }
}

impl OperatingPoint {
    /// Share of the true among the judged; 1 while none has been judged.
    pub(crate) fn precision(&self) -> f64 {
        let judged = self.true_proposals + self.false_proposals;
        if judged == 0 { 1.0 } else { self.true_proposals as f64 / judged as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Verdict::{False, Neutral, True};

    fn sweep(proposals: &[(f64, Verdict)], queries_with_loop: usize) -> PrecisionRecall {
        let judged = proposals.iter().map(|&(score, verdict)| JudgedProposal { score, verdict });
        PrecisionRecall::sweep(judged.collect(), queries_with_loop)
    }

    fn assert_close(found: Option<f64>, expected: f64) {
        assert!(found.is_some_and(|found| (found - expected).abs() < 1e-15), "{found:?} is not {expected}");
    }

    /// Scores fall: T T F T, and five frames have a loop.
    /// Precisions at the true ones are 1, 1 and 3/4.
    #[test]
    fn the_curve_by_hand() {
        let curve = sweep(&[(0.2, True), (0.9, True), (0.4, False), (0.7, True)], 5);
        assert_close(curve.recall_at_100_precision(), 2.0 / 5.0);
        assert_close(curve.average_precision(), (1.0 + 1.0 + 0.75) / 5.0);
        let precisions: Vec<f64> = curve.points.iter().map(OperatingPoint::precision).collect();
        assert_eq!(precisions, [1.0, 1.0, 2.0 / 3.0, 0.75]);
        let recalls: Vec<_> = curve.points.iter().filter_map(|point| curve.recall(point)).collect();
        assert_eq!(recalls, [0.2, 0.4, 0.4, 0.6]);
    }

    /// Two true and one false proposal share the second score: whichever is listed first, none of
    /// them passes without the others.
    #[test]
    fn equal_scores_pass_together() {
        let orders = [
            [(0.9, True), (0.5, True), (0.5, True), (0.5, False)],
            [(0.5, False), (0.5, True), (0.9, True), (0.5, True)],
        ];
        for order in orders {
            let curve = sweep(&order, 4);
            assert_eq!(curve.points.len(), 2);
            assert_close(curve.recall_at_100_precision(), 0.25);
            assert_close(curve.average_precision(), (1.0 + 2.0 * 0.75) / 4.0);
        }
        assert_close(sweep(&[(0.5, True), (0.5, False)], 1).recall_at_100_precision(), 0.0);
    }

    #[test]
    fn neutral_proposals_count_neither_way() {
        let curve = sweep(&[(0.9, Neutral), (0.8, True), (0.7, Neutral), (0.6, True), (0.5, False)], 2);
        assert_close(curve.recall_at_100_precision(), 1.0);
        assert_close(curve.average_precision(), 1.0);
        let all =
            OperatingPoint { threshold: 0.5, true_proposals: 2, false_proposals: 1, neutral_proposals: 2 };
        assert_eq!(curve.unthresholded(), Some(&all));
    }

    #[test]
    fn a_false_proposal_on_top_leaves_no_recall() {
        let curve = sweep(&[(0.9, False), (0.8, True)], 1);
        assert_close(curve.recall_at_100_precision(), 0.0);
        assert_close(curve.average_precision(), 0.5);
    }

    #[test]
    fn without_proposals_recall_is_zero() {
        let curve = sweep(&[], 3);
        assert_close(curve.recall_at_100_precision(), 0.0);
        assert_close(curve.average_precision(), 0.0);
        assert_eq!(curve.unthresholded(), None);
    }

    #[test]
    fn without_loops_there_is_no_recall() {
        let curve = sweep(&[(0.9, False)], 0);
        assert_eq!(curve.recall_at_100_precision(), None);
        assert_eq!(curve.average_precision(), None);
        assert_eq!(curve.unthresholded().map(|point| point.false_proposals), Some(1));
    }
}
