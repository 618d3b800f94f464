//! Where the camera went.

use super::{Batches, MapQueries, Scaled, SubmapChoice, TrajectoryKind, TrajectoryPose, batches};
use crate::error::ApiError;
use crate::session::SessionId;
use slam::map::SubmapId;
use std::collections::BTreeMap;
use store::TrajectoryFilter;

/// Which poses of a trajectory are wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrajectoryQuery {
    /// Every frame's or keyframes'.
    pub kind: TrajectoryKind,
    /// First time, nanoseconds.
    pub from_timestamp_ns: Option<i64>,
    /// Last time, nanoseconds.
    pub to_timestamp_ns: Option<i64>,
    /// Poses of these submaps.
    pub submaps: SubmapChoice,
}

impl MapQueries {
    /// How many poses of a kind each submap has.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn poses_by_submap(
        &self,
        id: &SessionId,
        kind: TrajectoryKind,
    ) -> Result<BTreeMap<SubmapId, u64>, ApiError> {
        Ok(self.store.poses_by_submap(id.as_str(), kind).await?)
    }

    /// How many poses of a kind are in other submaps than those chosen.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn n_poses_left_out(
        &self,
        id: &SessionId,
        kind: TrajectoryKind,
        chosen: SubmapChoice,
    ) -> Result<u64, ApiError> {
        let n_poses = match chosen {
            SubmapChoice::All => return Ok(0),
            SubmapChoice::Largest | SubmapChoice::One(_) => self.poses_by_submap(id, kind).await?,
        };
        let n_kept = match chosen {
            SubmapChoice::One(submap) => n_poses.get(&submap).copied(),
            _ => n_poses.values().copied().max(),
        };
        Ok(n_poses.values().sum::<u64>() - n_kept.unwrap_or(0))
    }

    /// The wanted poses in the order of their times, as the map stands now.
    ///
    /// # Errors
    /// If there is no such session.
    pub async fn trajectory(
        &self,
        id: &SessionId,
        query: &TrajectoryQuery,
    ) -> Result<Scaled<Batches<TrajectoryPose>>, ApiError> {
        let units = self.units(id).await?;
        let TrajectoryQuery { kind, from_timestamp_ns, to_timestamp_ns, submaps } = *query;
        let filter = TrajectoryFilter { from_timestamp_ns, to_timestamp_ns, submaps };
        let poses = self.store.trajectory(id.as_str(), kind, filter).await?;
        let scaled = move |pose: TrajectoryPose| TrajectoryPose {
            world_from_camera: units.scaled(&pose.world_from_camera),
            ..pose
        };
        Ok(Scaled::new(units, batches(poses, scaled)))
    }
}
