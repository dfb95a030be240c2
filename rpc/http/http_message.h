#pragma once

#include <functional>
#include <utility>

#include <boost/asio/error.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/read_size.hpp>
#include <boost/beast/http/basic_parser.hpp>
#include <boost/beast/http/error.hpp>

#include <iotcloud/rpc/http/http_line.h>

namespace iotcloud::rpc {

/// What is read of a message.
enum class HttpPart { head, whole };

/// Reads from `buffer`, and then from `line` through it, until the parser has this part of a message, and calls `done`;
/// with the error that it has of a parser or of the line, or with http::error::end_of_stream when the line ends where a
/// message could begin. `done` keeps the other arguments alive. Private to the sources of the pages.
template <bool is_request>
void read_message(HttpLine& line, boost::beast::flat_buffer& buffer,
                  boost::beast::http::basic_parser<is_request>& parser, HttpPart part,
                  std::function<void(boost::system::error_code)> done) {
  namespace http = boost::beast::http;
  constexpr std::size_t most_at_once = 65'536;
  boost::system::error_code error;
  parser.eager(part == HttpPart::whole);
  while (!error && !(part == HttpPart::head ? parser.is_header_done() : parser.is_done())) {
    if (buffer.size() > 0) {
      buffer.consume(parser.put(buffer.data(), error));
      if (error != http::error::need_more) continue;
      error = {};
    }
    return line.read_some(
        buffer.prepare(boost::beast::read_size(buffer, most_at_once)),
        [&line, &buffer, &parser, part, done = std::move(done)](boost::system::error_code failure, std::size_t count) {
          buffer.commit(count);
          if (failure == boost::asio::error::eof) {
            failure = {};
            if (parser.got_some()) {
              parser.put_eof(failure);
            } else {
              failure = http::error::end_of_stream;
            }
          }
          if (failure) return done(failure);
          read_message(line, buffer, parser, part, done);
        });
  }
  done(error);
}

}  // namespace iotcloud::rpc
