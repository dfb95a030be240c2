#include <utility>

#include <thrift/TApplicationException.h>
#include <thrift/TProcessor.h>
#include <thrift/processor/TMultiplexedProcessor.h>
#include <thrift/protocol/TProtocol.h>

#include <iotcloud/rpc/session.h>

namespace iotcloud::rpc {

using apache::thrift::TApplicationException;
using apache::thrift::TProcessor;
using apache::thrift::protocol::StoredMessageProtocol;
using apache::thrift::protocol::TMessageType;
using apache::thrift::protocol::TProtocol;
using apache::thrift::protocol::TType;

namespace {

constexpr std::int32_t failure_state = 1;  ///< TResponseState::FAILURE

void write_text(TProtocol& out, const char* name, std::int16_t id, const std::string& text) {
  out.writeFieldBegin(name, TType::T_STRING, id);
  out.writeString(text);
  out.writeFieldEnd();
}

void write_number(TProtocol& out, const char* name, std::int16_t id, std::int32_t number) {
  out.writeFieldBegin(name, TType::T_I32, id);
  out.writeI32(number);
  out.writeFieldEnd();
}

/// Writes the members of a TResponse.
void write_response(TProtocol& out, const std::string& text) {
  write_number(out, "state", 1, failure_state);
  write_text(out, "statusMessage", 2, text);
}

template <typename Members>
void write_struct(TProtocol& out, const char* name, std::int16_t id, Members&& members) {
  out.writeFieldBegin(name, TType::T_STRUCT, id);
  out.writeStructBegin(name);
  members();
  out.writeFieldStop();
  out.writeStructEnd();
  out.writeFieldEnd();
}

}  // namespace

class GuardedProcessor final : public TProcessor {
 public:
  GuardedProcessor(std::shared_ptr<TProcessor> processor, std::shared_ptr<CallerSession> session)
      : processor_(std::move(processor)), session_(std::move(session)) {}

  bool process(std::shared_ptr<TProtocol> in, std::shared_ptr<TProtocol> out, void* context) override {
    std::string method;
    TMessageType type{};
    std::int32_t number = 0;
    in->readMessageBegin(method, type, number);
    if (type != TMessageType::T_CALL) return false;
    const auto role = session_->role();
    auto refusal = session_->refuse_too_many(method, role);  // calls that are refused count too
    if (!refusal) refusal = session_->refuse(method, role);
    if (refusal) {
      in->skip(TType::T_STRUCT);
      in->readMessageEnd();
      write(*out, method, number, *refusal);
      return true;
    }
    session_->begin(method);
    const bool go_on =
        processor_->process(std::make_shared<StoredMessageProtocol>(std::move(in), method, type, number), out, context);
    session_->end();
    return go_on;
  }

 private:
  static void write(TProtocol& out, const std::string& method, std::int32_t number,
                    const CallerSession::Refusal& refusal) {
    if (refusal.form == RefusalForm::failure) {
      out.writeMessageBegin(method, TMessageType::T_EXCEPTION, number);
      TApplicationException(
          refusal.unknown ? TApplicationException::UNKNOWN_METHOD : TApplicationException::INTERNAL_ERROR, refusal.text)
          .write(&out);
    } else {
      out.writeMessageBegin(method, TMessageType::T_REPLY, number);
      out.writeStructBegin("result");
      if (refusal.form == RefusalForm::error) {
        write_struct(out, "error", 1, [&] { write_text(out, "reason", 1, refusal.text); });
      } else if (refusal.form == RefusalForm::response) {
        write_struct(out, "success", 0, [&] { write_response(out, refusal.text); });
      } else {
        write_struct(out, "success", 0, [&] {
          write_struct(out, "response", 1, [&] { write_response(out, refusal.text); });
          write_number(out, "refusal", 3, refusal.code);
        });
      }
      out.writeFieldStop();
      out.writeStructEnd();
    }
    out.writeMessageEnd();
    out.getTransport()->writeEnd();
    out.getTransport()->flush();
  }

  const std::shared_ptr<TProcessor> processor_;
  const std::shared_ptr<CallerSession> session_;
};

std::shared_ptr<TProcessor> guarded(std::shared_ptr<TProcessor> processor, std::shared_ptr<CallerSession> session) {
  return std::make_shared<GuardedProcessor>(std::move(processor), std::move(session));
}

}  // namespace iotcloud::rpc
