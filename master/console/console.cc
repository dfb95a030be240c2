#include <functional>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/api/gateway_asks.h>
#include <iotcloud/master/console/audit_lines.h>
#include <iotcloud/master/console/console.h>
#include <iotcloud/master/console/page_files.h>
#include <iotcloud/master/console/sessions.h>
#include <iotcloud/master/console/site_rules.h>
#include <iotcloud/master/listing/secret_properties.h>
#include <iotcloud/rpc/http/http_address.h>
#include <iotcloud/rpc/peer_user.h>
#include <iotcloud/security/logger.h>

namespace iotcloud::master {

namespace {

using Json = nlohmann::ordered_json;
using rpc::HttpAnswer;
using rpc::SiteRequest;
using ReplyPtr = std::shared_ptr<rpc::HttpReply>;
using security::Role;

constexpr std::size_t longest_log_in = 4'096;
constexpr std::size_t most_audit_lines = 10'000;
const std::string calls_path = "/api/call/", pages_path = "/page/";

HttpAnswer json_answer(const Json& json, int status = 200) {
  return {status, "application/json", discovery::to_text(json)};
}
HttpAnswer error(int status, const std::string& text) {
  return json_answer({{"error", text}}, status);
}

std::string query_of(const SiteRequest& request, const char* key) {
  const auto found = request.query.find(key);
  return found == request.query.end() ? "" : found->second;
}

}  // namespace

struct Console::Impl {
  Impl(Options given, Live::Source source, ConsoleCalls& made_calls)
      : options(std::move(given)),
        rules(options.settings),
        cookie(fmt::format("{}iotcloud_session_{}", options.settings.pages.tls.empty() ? "" : "__Host-",
                           rpc::HttpAddress(options.settings.pages.address).port)),
        sessions({.longest = options.settings.session, .idle = options.settings.idle}),
        calls(made_calls),
        page_plugins(options.settings.page_plugins),
        live(std::move(source), options.live),
        server(options.settings.pages,
               [this](SiteRequest request, const ReplyPtr& reply) { serve(std::move(request), reply); }) {}

  // ---- who asks

  std::string secret_of(const SiteRequest& request) const {
    const auto header = request.headers.find("cookie");
    return header == request.headers.end() ? "" : cookie_in(header->second, cookie);
  }

  ConsoleCaller caller_of(const SiteRequest& request) {
    ConsoleCaller caller{std::nullopt, request.user, request.address, request.certificate};
    if (options.tokens) caller.holder = sessions.find(secret_of(request));
    return caller;
  }

  Role role_of(const ConsoleCaller& caller) const {
    if (!options.tokens) {
      return options.open || (caller.user && rpc::is_trusted_user(*caller.user, options.users)) ? Role::admin
                                                                                                : Role::viewer;
    }
    return caller.holder ? options.tokens->role_of(*caller.holder).value_or(Role::anyone) : Role::anyone;
  }

  std::string set_cookie(const std::string& value, std::chrono::seconds age) const {
    return fmt::format("{}={}; Path=/; HttpOnly; SameSite=Strict; Max-Age={}{}", cookie, value, age.count(),
                       options.settings.pages.tls.empty() ? "" : "; Secure");
  }

  // ---- answers

  HttpAnswer guarded(HttpAnswer answer) const {
    const auto add = [&](const char* name, std::string value) { answer.headers.emplace_back(name, std::move(value)); };
    add("X-Content-Type-Options", "nosniff");
    add("Referrer-Policy", "no-referrer");
    add("Cross-Origin-Opener-Policy", "same-origin");
    const auto has = [&](const char* name) {
      for (const auto& [key, value] : answer.headers)
        if (key == name) return true;
      return false;
    };
    if (!has("Content-Security-Policy")) add("Content-Security-Policy", rules.policy());
    if (!has("Cross-Origin-Resource-Policy")) add("Cross-Origin-Resource-Policy", "same-origin");
    if (!has("Cache-Control")) add("Cache-Control", "no-store");
    return answer;
  }
  void answer(const ReplyPtr& reply, HttpAnswer answer) const { reply->answer(guarded(std::move(answer))); }

  /// Answers on one of the threads. \param body makes the answer, and may block
  void answer_later(GatewayAsks& threads, const ReplyPtr& reply, std::function<HttpAnswer()> body) {
    threads.ask([this, reply, body = std::move(body)] {
      try {
        answer(reply, body());
      } catch (const config::Error& problem) {
        answer(reply, error(400, problem.what()));
      } catch (const std::exception& problem) {
        answer(reply, error(500, problem.what()));
      }
    });
  }

  void serve(SiteRequest request, const ReplyPtr& reply) {
    if (const auto refusal = rules.refusal(request); !refusal.empty()) return answer(reply, error(403, refusal));
    const bool reads = request.method == "GET";
    if (request.path == "/alive" && reads)
      return answer(reply, {204, "text/plain", "", {{"Cross-Origin-Resource-Policy", "cross-origin"}}});
    if (const auto* const file = find_page_file(request.path); file != nullptr && reads)
      return answer(reply, file_answer(*file, request));
    if (request.path == "/api/session") return session(std::move(request), reply);
    auto caller = caller_of(request);
    const auto role = role_of(caller);
    if (request.path == "/api/me" && reads) return answer(reply, me(caller, role));
    if (role < Role::viewer) return answer(reply, error(401, "log in first"));
    if (request.path == "/api/live" && reads) return follow(request, caller, reply);
    if (request.path == "/api/instance" && reads) return instance(request, reply);
    if (request.path == "/api/audit" && reads) return audit(request, role, reply);
    if (request.path == "/api/pages" && reads) return answer_later(reading, reply, [this] { return all_pages(); });
    if (request.path.starts_with(pages_path) && reads) return robots_page(request, reply);
    if (request.path.starts_with(calls_path) && request.method == "POST") {
      auto name = request.path.substr(calls_path.size());
      auto& threads = name == "order" || name == "topology" ? acting : reading;
      return answer_later(threads, reply, [this, caller, name = std::move(name), body = std::move(request.body)] {
        return HttpAnswer{200, "application/json", calls.call(caller, name, body)};
      });
    }
    answer(reply, error(404, "the console has no " + request.method + " " + request.path));
  }

  static HttpAnswer file_answer(const PageFile& file, const SiteRequest& request) {
    const auto known = request.headers.find("if-none-match");
    HttpAnswer made{
        200, file.content_type, std::string(file.bytes), {{"Cache-Control", "no-cache"}, {"ETag", file.tag}}};
    if (known == request.headers.end() || known->second != file.tag) return made;
    made.status = 304;
    made.body.clear();
    return made;
  }

  HttpAnswer me(const ConsoleCaller& caller, Role role) const {
    return json_answer({{"master", options.id},
                        {"log_in", options.tokens != nullptr},
                        {"name", caller.holder ? caller.holder->name
                                 : caller.user ? "user " + std::to_string(*caller.user)
                                               : ""},
                        {"role", security::to_string(role)},
                        {"others", options.settings.others}});
  }

  void session(SiteRequest request, const ReplyPtr& reply) {
    if (request.method == "DELETE") {
      sessions.end(secret_of(request));
      return answer(reply, {204, "text/plain", "", {{"Set-Cookie", set_cookie("", std::chrono::seconds(0))}}});
    }
    if (request.method != "POST") return answer(reply, error(405, "a session is made by POST and ended by DELETE"));
    if (!options.tokens) return answer(reply, error(400, "this console asks for no token"));
    answer_later(reading, reply, [this, request = std::move(request)] { return log_in(request); });
  }

  HttpAnswer log_in(const SiteRequest& request) {
    const auto given = discovery::parse_json(request.body, "the log-in", longest_log_in);
    const auto token = given.is_object() ? given.value("token", std::string()) : std::string();
    const ConsoleCaller caller{std::nullopt, request.user, request.address, request.certificate};
    if (const auto why = calls.authenticate(caller, token); !why.empty()) return error(401, why);
    auto holder = options.tokens->holder(token, request.certificate);
    if (!holder) return error(401, "the token was taken away");
    if (role_of({holder, {}, {}, {}}) == Role::master) return error(403, "a daemon does not log in to the console");
    security::access_logger.info("console: {} has logged in from {}", holder->name, request.address);
    const auto age = std::chrono::duration_cast<std::chrono::seconds>(options.settings.session);
    return {204, "text/plain", "", {{"Set-Cookie", set_cookie(sessions.begin(*std::move(holder)), age)}}};
  }

  void follow(const SiteRequest& request, const ConsoleCaller& caller, const ReplyPtr& reply) {
    Live::Wanted wanted;
    wanted.rows = !query_of(request, "rows").empty();
    wanted.topology = discovery::TopologyName(query_of(request, "topology"));
    try {
      if (const auto where = query_of(request, "where"); !where.empty())
        wanted.where = discovery::Selection::parse(where);
    } catch (const config::Error& wrong) {
      return answer(reply, error(400, wrong.what()));
    }
    if (!query_of(request, "check").empty()) return answer(reply, json_answer(Json::object()));
    live.follow(reply->stream(guarded({200, "text/event-stream", "retry: 1000\n\n"})), std::move(wanted),
                [this, caller, secret = secret_of(request)] {
                  return !options.tokens || (sessions.find(secret) && role_of(caller) >= Role::viewer);
                });
  }

  void instance(const SiteRequest& request, const ReplyPtr& reply) {
    answer_later(reading, reply,
                 [this, gateway = query_of(request, "gateway"), id = query_of(request, "instance")]() -> HttpAnswer {
                   auto driver = live.find(discovery::GatewayId(gateway), discovery::InstanceId(id));
                   if (!driver) return error(404, "there is no instance " + id + " on " + gateway);
                   for (auto& channel : driver->channels) {
                     channel.broker_url = without_password(channel.broker_url);
                     for (auto& [key, value] : channel.properties)
                       if (is_secret(key, value)) value = "***";
                   }
                   Json record = discovery::to_json<Json>(*driver);
                   record["state"] = to_string(driver->state);
                   record["metadata"] = driver->metadata;
                   return json_answer(record);
                 });
  }

  void audit(const SiteRequest& request, Role role, const ReplyPtr& reply) {
    if (role < Role::operating) return answer(reply, error(403, "who did what is shown to operators and admins"));
    if (options.audit_file.empty())
      return answer(reply, error(404, "this master keeps no audit log; set audit: {file: ...} in its configuration"));
    answer_later(reading, reply, [this, text = query_of(request, "text")] {
      return HttpAnswer{200, "application/json", last_audit_lines(options.audit_file, text, most_audit_lines)};
    });
  }

  HttpAnswer all_pages() const {
    Json all = Json::array();
    for (const auto& page : page_plugins.list())
      all.push_back({{"name", page.name},
                     {"title", page.title},
                     {"driver", page.driver},
                     {"signed_by", page.signed_by},
                     {"problem", page.problem}});
    return json_answer({{"pages", std::move(all)}});
  }

  void robots_page(const SiteRequest& request, const ReplyPtr& reply) {
    answer_later(reading, reply, [this, name = request.path.substr(pages_path.size())] {
      auto page = page_plugins.document(name);
      return HttpAnswer{200,
                        "text/html; charset=utf-8",
                        std::move(page.html),
                        {{"Content-Security-Policy", std::move(page.policy)}, {"X-DNS-Prefetch-Control", "off"}}};
    });
  }

  const Options options;
  const SiteRules rules;
  const std::string cookie;
  Sessions sessions;
  ConsoleCalls& calls;
  const PagePlugins page_plugins;
  Live live;
  // After the server has ended nothing new comes to these; they end before what they use.
  GatewayAsks reading{8}, acting{16};
  rpc::HttpServer server;
};

Console::Console(Options options, Live::Source source, ConsoleCalls& calls)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(source), calls)) {}
Console::~Console() = default;

std::string Console::address() const {
  return impl_->server.address();
}

std::string Console::url() const {
  return (impl_->options.settings.pages.tls.empty() ? "http://" : "https://") + address() + "/";
}

void Console::reload() {
  impl_->server.reload();
}

}  // namespace iotcloud::master
