// The connection to a server that calls, sessions and navigations share.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>
#include <grpcpp/support/status.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "waypost/navigation.hpp"
#include "waypost/options.hpp"
#include "waypost/session.hpp"
#include "waypost/v1/map.pb.h"

namespace waypost {

class Connection;

// A connection to a server. Cheap to copy: copies share the connection. After it broke, the next call connects again.
// Several threads may use it. Sessions and navigations outlive it.
class Client {
 public:
  // Connects, and shows whether there is a server that takes the token. Throws ServerUnreachable if nobody answers
  // within `connect_timeout`, Unauthenticated if the server wants a token or another one, and InvalidUse if address,
  // token or certificates cannot be used.
  static Client connect(ClientOptions options = {});
  // Connects at the first call, for robots that may start before their server. Throws InvalidUse.
  static Client lazy(ClientOptions options = {});

  // Opens a session, or resumes the one of that name. Waits for an unreachable server up to `give_up_after`.
  Session open_session(SessionOptions options) const;
  // Starts to lead a robot, and waits until the server has opened the navigation. Throws NotFound if there is no such
  // map or goal, InvalidArgument if the camera does not say enough, FailedPrecondition if another stream leads this
  // robot or robots cannot navigate in this map.
  Navigation navigate(NavigationOptions options) const;

  // Makes an empty map. `model` is a model's name, such as `shipped`, or its hash; empty for the server's only model.
  v1::Map create_map(const std::string& map, const std::string& model = "",
                     const v1::MapSettings& settings = {}) const;
  // All maps, by name.
  std::vector<v1::Map> maps() const;
  // A map as it is now, by `{map}` or `maps/{map}`.
  v1::Map map(const std::string& name, v1::MapView view = v1::MAP_VIEW_BASIC) const;
  // The loop closures of a map, oldest first.
  std::vector<v1::LoopClosure> loop_closures(const std::string& map) const;

  // Any other call of the contract that is no stream, with `call_timeout`, the token, and errors of this library:
  // `client.call(&v1::LabelService::Stub::SetLabel, request)`.
  template <class Stub, class Request, class Response>
  Response call(grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                const Request& request) const {
    Stub stub(channel());
    const auto context = new_context();
    Response response;
    const grpc::Status status = (stub.*method)(context.get(), request, &response);
    check(status, *context);
    return response;
  }
  // A stub of your own, for streams: `client.stub<v1::EventService>()`. The token goes with its calls.
  template <class Service>
  std::unique_ptr<typename Service::Stub> stub() const {
    return Service::NewStub(channel());
  }
  // Throws what a call of such a stub ended with, as an Error; nothing if it went well.
  void check(const grpc::Status& status, const grpc::ClientContext& context) const;

  // It sends the token with every call.
  std::shared_ptr<grpc::Channel> channel() const;
  // The server's address, as it was given.
  const std::string& address() const noexcept;

 private:
  explicit Client(std::shared_ptr<const Connection> connection) noexcept;
  std::unique_ptr<grpc::ClientContext> new_context() const;

  std::shared_ptr<const Connection> connection_;
};

}  // namespace waypost
