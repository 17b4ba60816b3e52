//! Robots that are led, for whoever sends them; ways that would be taken.

use waypost_proto::v1;

use crate::client::{Client, map_name};
use crate::error::Error;

impl Client {
    /// Sends a robot that is led to a goal; `name` is `maps/{map}/navigations/{navigation}`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if it is not being led.
    pub async fn set_goal(&self, name: &str, goal: v1::Goal) -> Result<v1::Navigation, Error> {
        let request = v1::SetGoalRequest { name: name.to_owned(), goal: Some(goal), image_goal: None };
        let response = self.taken(self.navigations_client().set_goal(request).await)?;
        response.navigation.ok_or(Error::Protocol("it answered without the navigation"))
    }

    /// Sends a robot that is led by appearance to where a panorama was taken, a JPEG or PNG.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND if it is not being led or the image looks like no place, FAILED_PRECONDITION if the map
    /// is not navigated by appearance.
    pub async fn set_image_goal(&self, name: &str, image: Vec<u8>) -> Result<v1::Navigation, Error> {
        let image_goal = Some(v1::ImageGoal { image });
        let request = v1::SetGoalRequest { name: name.to_owned(), goal: None, image_goal };
        let response = self.taken(self.navigations_client().set_goal(request).await)?;
        response.navigation.ok_or(Error::Protocol("it answered without the navigation"))
    }

    /// Takes a robot's goal away: it stops.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND if it is not being led.
    pub async fn cancel_goal(&self, name: &str) -> Result<v1::Navigation, Error> {
        let request = v1::CancelGoalRequest { name: name.to_owned() };
        let response = self.taken(self.navigations_client().cancel_goal(request).await)?;
        response.navigation.ok_or(Error::Protocol("it answered without the navigation"))
    }

    /// A robot that is being led, or was a moment ago.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn navigation(&self, name: &str) -> Result<v1::Navigation, Error> {
        let request = v1::GetNavigationRequest { name: name.to_owned() };
        self.taken(self.navigations_client().get_navigation(request).await)
    }

    /// All robots that are led in a map, by name.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub async fn navigations(&self, map: &str) -> Result<Vec<v1::Navigation>, Error> {
        self.all_pages(|page_token| {
            let mut service = self.navigations_client();
            let request = v1::ListNavigationsRequest { map: map_name(map), page_size: 0, page_token };
            async move {
                let page = service.list_navigations(request).await?.into_inner();
                Ok((page.navigations, page.next_page_token))
            }
        })
        .await
    }

    /// Which way would be taken from a place to a goal.
    ///
    /// # Errors
    /// [`Error::Status`]: NOT_FOUND, FAILED_PRECONDITION if there is none.
    pub async fn plan_route(&self, request: v1::PlanRouteRequest) -> Result<v1::Route, Error> {
        let response = self.taken(self.navigations_client().plan_route(request).await)?;
        response.route.ok_or(Error::Protocol("it answered without a route"))
    }
}
