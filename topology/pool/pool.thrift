// The service of a pool of workers: framed transport, binary protocol. Masters call it. Methods that a gateway has, too,
// are those of gateway/gateway.thrift.
include "iotcloud/discovery/records.thrift"
namespace cpp iotcloud.topology.wire

struct TPoolPing {
  // The pool's id.
  1: string pool
  // The pool's wall time, milliseconds since 1970 UTC.
  2: i64 timeMs
}

struct TWorkerLogPart {
  // Whole lines, unless a line is longer than `mostBytes`.
  1: string text
  // The position of the next part.
  2: string position
}

// A component library that a client wants to send.
struct TLibraryOffer {
  // File name without a path.
  1: string plugin
  // SHA-256 of the library's bytes: 64 hexadecimal digits in lower case.
  2: string sha256
  // In bytes.
  3: i64 size
  // Ed25519 signature of the library's bytes; empty: not signed.
  4: binary signature
}

// A library that the pool keeps.
struct TKeptLibrary {
  // In bytes.
  1: i64 size
  // Empty: not signed.
  2: binary signature
}

// The pool cannot do it.
exception TPoolError {
  1: string reason
}

service TPoolService {
  // Must be the first call on a connection to a pool that requires a token. One that requires none answers SUCCESS.
  records.TResponse authenticate(1: string token)
  // Answers as long as the pool serves calls.
  TPoolPing ping()
  // A part of the log of the workers at a place of a topology. position: that of an earlier answer; empty: the end of
  // the log.
  TWorkerLogPart readLog(1: string topology, 2: i32 place, 3: string position, 4: i32 mostBytes)
    throws (1: TPoolError error)
  // Begins to send a library; its pieces must each fit into a message of 1 MB. The answer is the upload's id; empty: the
  // pool has the library already. An upload without a call for a minute ends.
  string offerLibrary(1: TLibraryOffer offer) throws (1: TPoolError error)
  // Sends the piece that begins at `offset`. Pieces must come in order, without gaps. An error ends the upload.
  void sendLibrary(1: string upload, 2: i64 offset, 3: binary bytes) throws (1: TPoolError error)
  // Ends the upload. Submissions may name the library when this call has returned.
  void finishLibrary(1: string upload) throws (1: TPoolError error)
  // What a master needs to send a library that this pool has to another one.
  TKeptLibrary describeLibrary(1: string sha256) throws (1: TPoolError error)
  // Half a megabyte of it at most, from `offset` on.
  binary readLibrary(1: string sha256, 2: i64 offset) throws (1: TPoolError error)
}
