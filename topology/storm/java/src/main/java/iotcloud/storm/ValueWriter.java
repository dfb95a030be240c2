package iotcloud.storm;

import java.nio.BufferOverflowException;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.List;
import java.util.function.Consumer;

/** Writes a tuple's values for C++, as topology/storm/value_format.h describes them. */
final class ValueWriter {
  private static final int LEAST_ARRAY = 16 << 10;

  private final boolean apart;
  private final Consumer<ByteBuffer> replaced;
  private final List<byte[]> arrays = new ArrayList<>();
  private ByteBuffer buffer;

  /**
   * `apart`: large payloads do not go into the buffer, but among arrays(). `replaced` gets the first buffer, and each larger
   * one that takes its place.
   */
  ValueWriter(int size, boolean apart, Consumer<ByteBuffer> replaced) {
    this.apart = apart;
    this.replaced = replaced;
    replace(size);
  }

  private void replace(int size) {
    buffer = ByteBuffer.allocateDirect(size).order(ByteOrder.LITTLE_ENDIAN);
    replaced.accept(buffer);
  }

  /** Returns how many bytes it wrote. Throws IllegalArgumentException for a value that C++ cannot have. */
  int write(List<Object> values) {
    while (true) {
      try {
        arrays.clear();
        buffer.clear();
        buffer.putInt(values.size());
        for (int i = 0; i < values.size(); i++) {
          write(values.get(i), i);
        }
        return buffer.position();
      } catch (BufferOverflowException full) {
        replace(Math.multiplyExact(buffer.capacity(), 2));
      }
    }
  }

  /** The payloads that are not in the buffer, of the last write(); null: none. */
  byte[][] arrays() {
    if (arrays.isEmpty()) {
      return null;
    }
    byte[][] taken = arrays.toArray(new byte[0][]);
    arrays.clear();
    return taken;
  }

  private void write(Object value, int place) {
    if (value instanceof Long || value instanceof Integer || value instanceof Short || value instanceof Byte) {
      buffer.put(ValueKind.INTEGER).putLong(((Number) value).longValue());
    } else if (value instanceof String) {
      bytes(ValueKind.STRING, ((String) value).getBytes(StandardCharsets.UTF_8));
    } else if (value instanceof byte[]) {
      payload((byte[]) value);
    } else if (value instanceof Double || value instanceof Float) {
      buffer.put(ValueKind.REAL).putDouble(((Number) value).doubleValue());
    } else if (value instanceof Boolean) {
      buffer.put((Boolean) value ? ValueKind.YES : ValueKind.NO);
    } else if (value == null) {
      buffer.put(ValueKind.NULL);
    } else {
      throw new NoValue(place, value.getClass());
    }
  }

  private void payload(byte[] bytes) {
    if (apart && bytes.length >= LEAST_ARRAY) {
      buffer.put(ValueKind.ARRAY);
      arrays.add(bytes);
    } else {
      bytes(ValueKind.PAYLOAD, bytes);
    }
  }

  private void bytes(byte kind, byte[] bytes) {
    buffer.put(kind).putInt(bytes.length).put(bytes);
  }

  /** A value that C++ cannot have. */
  static final class NoValue extends IllegalArgumentException {
    private static final long serialVersionUID = 1;
    private final int place;
    private final Class<?> is;

    NoValue(int place, Class<?> is) {
      super("value " + place + " is a " + is.getName());
      this.place = place;
      this.is = is;
    }

    String of(String source, String field) {
      return "the field \"" + field + "\" of " + source + " is a " + is.getName() + "; C++ components take null, Boolean, "
          + "Long (or Integer, Short, Byte), Double (or Float), String and byte[]";
    }

    int place() {
      return place;
    }
  }
}
