// What anybody may send to a daemon's pages: bytes of one connection, to a real server over loopback.
#include <array>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "iotcloud/rpc/http/http_server.h"
#include "iotcloud/security/tokens.h"
#include "iotcloud/tests/config/hand_clock.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

namespace {

/// Serves a page that shows what was understood of the request.
class Server {
 public:
  Server(const std::string& tokens, const config::Clock& clock)
      : server_(rpc::PageSettings{"127.0.0.1:0", {}, tokens},
                {{"/page",
                  [](const rpc::HttpRequest& request) {
                    std::string text = request.path;
                    for (const auto& [key, value] : request.query) text += key + "=" + value + "\n";
                    return rpc::HttpAnswer{200, "text/plain", text};
                  }}},
                clock) {}
  int port() const { return std::stoi(server_.address().substr(server_.address().rfind(':') + 1)); }

 private:
  rpc::HttpServer server_;
};

/// A file with the token of "anna", which no input knows.
std::string file_of_tokens() {
  const std::string file =
      std::filesystem::temp_directory_path() / ("iotcloud-fuzz-tokens-" + std::to_string(getpid()));
  std::filesystem::remove(file);
  security::add_token(file, "anna", security::Role::viewer);
  return file;
}

/// Sends the bytes on a connection of their own. \return all that the server answers until it closes
std::string answer_to(std::string_view bytes, int port) {
  const int descriptor = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  fuzz::must(connect(descriptor, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0,
             "the server takes connections");
  // The server may answer and close before all of it was sent.
  static_cast<void>(send(descriptor, bytes.data(), bytes.size(), MSG_NOSIGNAL));
  shutdown(descriptor, SHUT_WR);
  std::string answer;
  std::array<char, 4096> part{};
  for (ssize_t size = 0; (size = recv(descriptor, part.data(), part.size(), 0)) > 0;)
    answer.append(part.data(), static_cast<std::size_t>(size));
  close(descriptor);
  return answer;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(http, 2'000) {
  static tests::HandClock clock;
  clock.advance(std::chrono::milliseconds{20});  // no input waits for the turn of who asks for too much
  static const int open = [] {
    static const Server server("", clock);
    return server.port();
  }();
  static const int guarded = [] {
    const std::string tokens = file_of_tokens();
    static const Server server(tokens, clock);
    std::filesystem::remove(tokens);
    return server.port();
  }();
  const auto bytes = fuzz::text(data, size);
  const std::string answer = answer_to(bytes, open);
  fuzz::must(answer.empty() || answer.starts_with("HTTP/1."), "what is answered is HTTP");
  const std::string without_token = answer_to(bytes, guarded);
  fuzz::must(without_token.empty() || without_token.starts_with("HTTP/1."), "what is answered is HTTP");
  fuzz::must(without_token.find("HTTP/1.1 200") == std::string::npos &&
                 without_token.find("HTTP/1.0 200") == std::string::npos,
             "nobody reads a guarded page without a token");
}
